"""What the two USB boards have in common: one frame of settings out, one of everything back, in each tick."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection
from dataclasses import dataclass
from struct import Struct
from typing import Final

from firmware_protocol import Field, FrameTable, ProtocolError
from inteco_abs.boards.board import STILL_ON, Board, Identity, Survey
from inteco_abs.boards.board_clock import BoardClock
from inteco_abs.boards.links import Link
from inteco_abs.boards.trust import distrust
from inteco_abs.config import BoardConfig
from inteco_abs.errors import BoardError, ConfigError, LinkError, Mistake
from inteco_abs.signals import Command

_EXACT: Final = 1e-9
"""Keeps a duty that is a whole number of widths from losing one to binary rounding."""
MODES: Final = ("8-bit", "12-bit")
_MOST_OLD: Final = 100
"""More answers to older requests than this are no leftover of a pause."""
_PINS: Final = ("pin_mode", "pin_direction", "encoder_reset")
_TIMERS: Final = ("timer_reset", "timer_mode")


@dataclass(frozen=True, slots=True)
class FrameLayout:
    """One logic's frames, and what a driver has to know besides the tables."""

    read: FrameTable
    send: FrameTable
    header: FrameTable
    """What a READ frame of any logic tells of the board, in its first `header_bytes`."""
    header_bytes: int
    request: bytes
    pwm_channels: int
    pwm_full_width: tuple[int, ...]
    """Width that stands for a duty of 1, in 8-bit and in 12-bit mode."""
    number: Struct
    """One word of a frame; the lower `number_bits` of a prescaler travel in the first of its words, both ways."""
    number_bits: int


class FrameBoard(Board):
    """The board behind `link`, wired as `wiring` says; see `Board` for what it promises.

    The output image is built once, when the board is opened: words that the wiring owns come from the wiring,
    all other words from the first read, all PWM widths are zero. In a tick only the two widths change, and the
    number of the frame, for which the prescaler of a PWM channel that is wired to nothing is used: the board echoes
    it, so that an answer to an older request, late or duplicated, is told from the one to this request. Where the
    wiring has a timer, it dates the samples, and shows such an answer, too. It is set to zero when the board is opened,
    and each time SAFE is to be confirmed, so that no answer from before can confirm it.

    Raises ConfigError for a wiring that the logic has no channels for.
    """

    def __init__(self, link: Link, wiring: BoardConfig, now_ns: Callable[[], int], period_ns: int) -> None:
        super().__init__(now_ns, period_ns)
        self._link = link
        self._wiring = wiring
        self._layout = layout = self._layout_of(wiring)
        self._mode = MODES.index(wiring.pwm_mode)
        self._full = layout.pwm_full_width[self._mode]
        _insist_on_channels(wiring, layout)
        self._widths = drive, brake = f"pwm{wiring.drive_pwm}_width", f"pwm{wiring.brake_pwm}_width"
        self._drive_out, self._brake_out = layout.send.place(drive), layout.send.place(brake)
        self._drive_echo, self._brake_echo = layout.read.place(drive), layout.read.place(brake)
        self._wheel = layout.read.place(f"encoder{wiring.wheel_encoder}_count")
        self._road = layout.read.place(f"encoder{wiring.road_encoder}_count")
        numbered = f"pwm{wiring.numbering_pwm}_prescaler" if wiring.numbering_pwm >= 0 else ""
        self._number = 0
        self._numbers = 1 << layout.number_bits
        self._number_at = _first_byte(layout.send, numbered) if numbered else -1
        self._number_echo = _first_byte(layout.read, numbered) if numbered else -1
        self._clock = BoardClock(wiring.timer_hz) if wiring.timer >= 0 else None
        self._timer = layout.read.place(f"timer{wiring.timer}_value") if wiring.timer >= 0 else None
        self._taken_ns = 0  # when the counts of the newest answer were taken, by that clock
        self._shared = (*_PINS, *_TIMERS) if wiring.timer >= 0 else _PINS  # fields of which some bits are the wiring's
        self._image = bytearray(layout.send.size)
        self._settings: dict[str, int] = {}
        self._header = b""
        self._late = False  # whether an exchange failed, so that its answer may still come

    @abstractmethod
    def _layout_of(self, wiring: BoardConfig) -> FrameLayout:
        """Layout of the logic that the profile expects."""

    def identify(self) -> Identity:
        """Read the header once; nothing is written but the READ request."""
        if not self._ready:
            self._link.prepare(self._layout.read.size)
        frame = self._read()
        try:
            values = self._layout.header.decode_some(frame, _known(self._layout.header))
        except ProtocolError as error:
            raise LinkError(f"the board's answer is no READ frame: {error}") from error
        if not self._ready:  # an open board that now calls itself something else has been reset or replaced
            self._header = frame[: self._layout.header_bytes]
        version, name = int(values["logic_version"]), str(values["application_name"])
        because = distrust(self._wiring, version, name, self._relied_on())
        if because:
            because += self._warning(frame)
        return Identity(version, name, str(values.get("synthesis_date", "")), because)

    def survey(self, names: Collection[str] = ()) -> Survey:
        """Read the board once: the named fields, or all."""
        table = self._layout.read
        unknown = [name for name in names if name not in table.fields]
        if unknown:
            raise BoardError(f"{table.title} has no field {', '.join(unknown)}")
        frame = self._read()
        try:
            values = table.decode_some(frame, names or table.fields)
        except ProtocolError as error:
            raise LinkError(f"the board's answer is no READ frame: {error}") from error
        if not frame.startswith(self._header):
            raise LinkError("the answer's header is not this board's: the frame is damaged or the board was reset")
        return Survey(values, frame)

    def _relied_on(self) -> list[Field]:
        """What outputs rest on of the frames."""
        encoders = (f"encoder{i}_count" for i in (self._wiring.wheel_encoder, self._wiring.road_encoder))
        clock = [f"timer{self._wiring.timer}_value"] if self._clock else []
        names = [*self._owned(dict.fromkeys(self._shared, 0)), *encoders, *clock]
        return [self._layout.read.fields[name][0] for name in names]

    def _warning(self, frame: bytes) -> str:
        """What must be said of the outputs of a board that nothing may be written to."""
        try:
            values = self._layout.read.decode_some(frame, self._widths)
        except ProtocolError:  # another logic: where its widths are is not known
            return f". Whether its PWM outputs are zero cannot be told. {STILL_ON}"
        return f". ITS PWM OUTPUTS ARE NOT ZERO and stay as they are. {STILL_ON}" if any(values.values()) else ""

    def _take_over(self) -> None:
        layout = self._layout
        try:
            found = layout.read.decode(self._read())
            self._settings = self._owned({name: int(found[name]) for name in self._shared})
            kept = {name: found[name] for name in layout.send.fields}
            self._image[:] = layout.send.encode({**kept, **self._settings})
        except ProtocolError as error:
            raise BoardError(f"the board's settings cannot be taken over: {error}") from error

    @property
    def safe_image(self) -> bytes:
        """The header that every answer of this board begins with, and the SEND frame with all widths zero."""
        image = bytearray(self._image)
        for place in (self._drive_out, self._brake_out):
            place.codec.pack_into(image, place.offset, 0)
        return self._header + bytes(image)

    def _adopt(self, image: bytes) -> None:
        length = self._layout.header_bytes
        self._header, self._image[:] = image[:length], image[length:]
        self._late = True  # so that what the other process had asked for is dropped first, whatever its number

    def _start(self) -> tuple[int, int]:
        frame = self._write_off()
        echo = self._layout.read.decode(frame)
        wrong = [f"{name} = {echo[name]}, not {value}" for name, value in self._settings.items() if echo[name] != value]
        if wrong:
            raise BoardError(f"the board did not take its settings: {'; '.join(wrong)}")
        return self._counts(frame)

    def _owned(self, found: dict[str, int]) -> dict[str, int]:
        """What the wiring decides, given the pins and resets as the board has them."""
        wiring = self._wiring
        pins = _mask(wiring.pwm_pins)
        functions = pins if wiring.pwm_functions is None else _mask(wiring.pwm_functions)
        channels = (wiring.drive_pwm, wiring.brake_pwm)
        owned = {
            **{f"pwm{channel}_width": 0 for channel in range(self._layout.pwm_channels)},
            **{f"pwm{channel}_mode": self._mode for channel in channels},
            **{f"pwm{channel}_prescaler": wiring.pwm_prescaler for channel in channels},
            "pin_mode": found["pin_mode"] | functions,
            "pin_direction": found["pin_direction"] & ~pins,
            "encoder_reset": found["encoder_reset"] & ~_mask((wiring.wheel_encoder, wiring.road_encoder)),
        }
        if wiring.timer >= 0:
            owned["timer_reset"] = found["timer_reset"] & ~(1 << wiring.timer)
            owned["timer_mode"] = found["timer_mode"] | 1 << wiring.timer
        return owned

    def _transfer(self, command: Command) -> tuple[int, int]:
        drive, brake = widths(command, self._full)
        return self._counts(self._write_widths(drive, brake))

    def _dated(self, now: int) -> int:
        return now if self._clock is None else self._taken_ns

    def _write_safe(self) -> None:
        self._write_off()

    def _write_off(self) -> bytes:
        """SEND both widths zero with the timer held at zero, then as `_write_widths` does."""
        if self._clock is not None:
            self._link.write(self._held_at_zero())
            self._clock.restart(self._now_ns())
        self._start_ns = self._now_ns()
        return self._write_widths(0, 0)

    def _held_at_zero(self) -> bytearray:
        """The SAFE image, but that the timer is held at zero."""
        image, reset = bytearray(self.safe_image[self._layout.header_bytes :]), self._layout.send.place("timer_reset")
        (others,) = reset.codec.unpack_from(image, reset.offset)
        reset.codec.pack_into(image, reset.offset, others | 1 << self._wiring.timer)
        return image

    def _write_widths(self, drive: int, brake: int) -> bytes:
        """SEND both widths, READ, and check that the answer is this board's and echoes them."""
        image, layout, link = self._image, self._layout, self._link
        self._drive_out.codec.pack_into(image, self._drive_out.offset, drive)
        self._brake_out.codec.pack_into(image, self._brake_out.offset, brake)
        if self._number_at >= 0:
            self._number = (self._number + 1) % self._numbers
            layout.number.pack_into(image, self._number_at, self._number)
        if self._late:
            link.write(image)
            # the answer of a failed exchange must not be taken for this one's; the output has gone out before
            link.discard(len(image))
            answer = self._read()
        else:
            self._late = True
            answer = self._whole(link.exchange(image, layout.request, layout.read.size))
        frame = self._newest(answer)
        echo = (
            self._drive_echo.codec.unpack_from(frame, self._drive_echo.offset)[0],
            self._brake_echo.codec.unpack_from(frame, self._brake_echo.offset)[0],
        )
        if echo != (drive, brake):
            raise LinkError(
                f"the board reports PWM widths {echo}, sent were {(drive, brake)}: an old frame, or another master"
            )
        self._late = False
        return frame

    def _newest(self, frame: bytes) -> bytes:
        """The answer to the newest request, `frame` or one that follows it; older ones are dropped."""
        number = self._layout.number
        for _ in range(_MOST_OLD):
            if not frame.startswith(self._header):
                raise LinkError("the answer's header is not this board's: the frame is damaged or the board was reset")
            at = self._number_echo
            numbered = at < 0 or number.unpack_from(frame, at)[0] % self._numbers == self._number
            if numbered and self._date(frame):
                return frame
            try:
                frame = self._whole(self._link.read(self._layout.read.size))
            except LinkError as error:
                why = self._clock.fault if numbered and self._clock else "the answer is one to an older request"
                raise LinkError(f"{why}; and no other follows: {error}") from error
        raise LinkError("the board answers only requests of long ago: is another program reading from it?")

    def _date(self, frame: bytes) -> bool:
        """Note when the board made the answer; False if not while this exchange went on."""
        if self._clock is None or self._timer is None:
            return True
        (reading,) = self._timer.codec.unpack_from(frame, self._timer.offset)
        self._taken_ns = self._clock.instant(reading, self._start_ns, self._now_ns())
        return self._taken_ns >= 0

    def _counts(self, frame: bytes) -> tuple[int, int]:
        (wheel,) = self._wheel.codec.unpack_from(frame, self._wheel.offset)
        (road,) = self._road.codec.unpack_from(frame, self._road.offset)
        return self._wiring.wheel_sign * wheel, self._wiring.road_sign * road

    def _read(self) -> bytes:
        self._link.write(self._layout.request)
        return self._whole(self._link.read(self._layout.read.size))

    def _whole(self, frame: bytes) -> bytes:
        size = self._layout.read.size
        if len(frame) != size:
            raise LinkError(f"the board's answer has {len(frame)} bytes, must be {size}: check the cable, avoid hubs")
        return frame

    def _close(self) -> None:
        self._link.close()


def widths(command: Command, full: int) -> tuple[int, int]:
    """PWM widths of drive and brake for duties of which 1 is `full`; raises BoardError for any other duty."""
    if not (0.0 <= command.drive <= 1.0 and 0.0 <= command.brake <= 1.0):  # NaN fails too
        raise BoardError(f"{command}: duties must be in 0..1")  # never masked into something else
    # rounded down: the output is never more than what the guard has admitted
    return int(command.drive * full + _EXACT), int(command.brake * full + _EXACT)


def _insist_on_channels(wiring: BoardConfig, layout: FrameLayout) -> None:
    wanted = {
        "drive_pwm": f"pwm{wiring.drive_pwm}_width",
        "brake_pwm": f"pwm{wiring.brake_pwm}_width",
        "numbering_pwm": f"pwm{max(wiring.numbering_pwm, 0)}_prescaler",
        **({"timer": f"timer{wiring.timer}_value"} if wiring.timer >= 0 else {}),
        "wheel_encoder": f"encoder{wiring.wheel_encoder}_count",
        "road_encoder": f"encoder{wiring.road_encoder}_count",
    }
    mistakes = [
        Mistake(f"board.{key}", f"{getattr(wiring, key)}: {layout.read.title} has no such channel")
        for key, name in wanted.items()
        if name not in layout.read.fields
    ]
    if mistakes:
        raise ConfigError(mistakes)


def _mask(bits: list[int] | tuple[int, ...]) -> int:
    return sum(1 << bit for bit in set(bits))


def _first_byte(table: FrameTable, name: str) -> int:
    """Byte at which a field's first word stands in its frame."""
    _, layout = table.fields[name]
    return (layout[0].word + table.data_from) * table.word_bits // 8


def _known(header: FrameTable) -> list[str]:
    return [name for name in ("logic_version", "application_name", "synthesis_date") if name in header.fields]
