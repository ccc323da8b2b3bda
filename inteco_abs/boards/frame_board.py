"""The common driver of the two USB boards: each tick sends one frame of settings and reads one of everything."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from struct import Struct
from typing import Final

from firmware_protocol import FrameField, FrameTable, Logic, ProtocolError
from firmware_protocol.fields import BYTE_BITS, first_word, sent_back
from firmware_protocol.pwm import PWM_FULL_WIDTH, PWM_MODES
from inteco_abs.boards.authorization import read_only_reason
from inteco_abs.boards.board import STILL_ON, Board, BoardReading, Identity
from inteco_abs.boards.board_clock import BoardClock
from inteco_abs.boards.constants import constants_of
from inteco_abs.boards.echoed_pins import EchoedPins
from inteco_abs.boards.first_write import PlannedWord, planned_words
from inteco_abs.boards.frame_exchange import ExchangeConstants, ExchangeState
from inteco_abs.boards.transports.links import Link
from inteco_abs.config import BoardConfig
from inteco_abs.errors import BoardError, ConfigError, ConfigIssue, LinkError, NoAnswerError
from inteco_abs.signals import Command, pwm_steps

_MOST_OLD: Final = 100
"""A pause leaves fewer answers to older requests than this."""
_SHARED: Final = ("pin_mode", "pin_direction", "pin_output", "encoder_reset", "timer_reset", "timer_mode")
"""The wiring decides some bits of these fields; the others stay as read."""
_PERIODS: Final = 2.0
"""Time-out of an exchange in the loop, periods: a lost answer costs three ticks, a slow exchange one."""
_LEAST_TIMEOUT_S: Final = 0.001
"""The shortest time-out of libusb, and twice a slow exchange over a high-speed bus."""


class FrameBoard(Board):
    """Driver of the board behind `link` with this wiring; see `Board` for its guarantees.

    The output image is built once, at opening: the wiring's fields from the wiring, with the widths of drive and brake
    zero, all other bits from the first read, unknown ones included. A tick changes only the two widths, the watchdog's
    pin, and the frame number, which uses the prescaler of an unwired PWM channel or the latch of unwired pins. The
    board echoes the number, which detects an answer to an older request. A timer in the wiring dates the
    samples and detects such an answer too; it is set to zero at opening and before each confirmation of SAFE, so that
    no earlier answer can confirm it.

    Other PWM channels keep their widths. The sign-off states on which channels drive and brake are, and without one
    nothing is written; commissioning refuses a board on which another channel runs, unless `board.constants` sets it.

    Raises ConfigError for a wiring or constants that the logic has no place for.
    """

    def __init__(self, link: Link, wiring: BoardConfig, now_ns: Callable[[], int], period_ns: int) -> None:
        super().__init__(now_ns, period_ns)
        self._link = link
        self.engines = link.engines
        self._wiring = wiring
        self._logic = logic = self._logic_of(wiring)
        self._mode = PWM_MODES.index(wiring.pwm_mode)
        self._full = PWM_FULL_WIDTH[self._mode]
        _require_channels(wiring, logic)
        drive, brake = f"pwm{wiring.drive_pwm}_width", f"pwm{wiring.brake_pwm}_width"
        self._drive_out, self._brake_out = logic.send.place(drive), logic.send.place(brake)
        self._drive_echo, self._brake_echo = logic.read.place(drive), logic.read.place(brake)
        self._wheel = logic.read.place(f"encoder{wiring.wheel_encoder}_count")
        self._road = logic.read.place(f"encoder{wiring.road_encoder}_count")
        numbered = f"pwm{wiring.numbering_pwm}_prescaler" if wiring.numbering_pwm >= 0 else ""
        self._number = 0
        self._number_word = Struct("<B" if logic.send.word_bits == BYTE_BITS else "<H")
        self._numbers = 1 << logic.send.payload_bits  # the lower bits of the prescaler's first word, both ways
        self._number_at = _first_byte(logic.send, numbered) if numbered else -1
        self._number_echo = _first_byte(logic.read, numbered) if numbered else -1
        self._clock = BoardClock(wiring.timer_hz) if wiring.timer >= 0 else None
        self._timer = logic.read.place(f"timer{wiring.timer}_value") if wiring.timer >= 0 else None
        self._taken_ns = 0  # time of the newest answer's counts
        owned = [*self._of_wiring({}), *([numbered] if numbered else [])]
        self._constants = constants_of(wiring, logic.send, owned)
        # both width words are sent whole: no unknown bit stays on
        self._decided = {part.word: 0 for name in (drive, brake) for part in logic.send.fields[name][1]}
        self._decided |= self._constants.words
        self._image = bytearray(logic.send.size)
        self._pins: EchoedPins | None = None
        self._newest_frame = b""
        self._good = False  # whether the newest exchange was
        self._settings: dict[str, int] = {}
        self._header = b""
        self._late = False  # whether the answer of a failed exchange may still come
        # whether number or time detects an answer to an older request, so that it can be skipped
        self._knows_late = (bool(numbered) or self._clock is not None) and link.keeps_boundaries
        self._patient_s = self._timeout_s = link.timeout_s
        self._hurried_s = min(self._patient_s, max(_LEAST_TIMEOUT_S, _PERIODS * period_ns * 1e-9))

    @abstractmethod
    def _logic_of(self, wiring: BoardConfig) -> Logic:
        """Return the frames of the profile's logic."""

    def identify(self) -> Identity:
        """Read the header once; writes nothing but the READ request."""
        if not self._ready:
            self._link.prepare(self._logic.read.size)
        frame = self._read()
        try:
            values = self._logic.header.decode_some(frame, _known(self._logic.header))
        except ProtocolError as error:
            raise LinkError(f"the board's answer is not a READ frame: {error}") from error
        if not self._ready:  # an open board with another header was reset or replaced
            self._header = frame[: self._logic.header_bytes]
        version, name = int(values["logic_version"]), str(values["application_name"])
        because = read_only_reason(self._wiring, version, name, self._relied_on())
        if because:
            because += self._warning(frame)
        return Identity(version, name, str(values.get("synthesis_date", "")), because)

    def survey(self, names: Collection[str] = ()) -> BoardReading:
        """Read the named fields, or all, once."""
        table = self._logic.read
        unknown = [name for name in names if name not in table.fields]
        if unknown:
            raise BoardError(f"{table.title} has no field {', '.join(unknown)}")
        frame = self._read()
        try:
            values = table.decode_some(frame, names or table.fields)
        except ProtocolError as error:
            raise LinkError(f"the board's answer is not a READ frame: {error}") from error
        if not frame.startswith(self._header):
            raise LinkError("the answer's header is not this board's: the frame is damaged or the board was reset")
        return BoardReading(values, frame)

    def _relied_on(self) -> list[FrameField]:
        """Return the fields that outputs rest on."""
        encoders = (f"encoder{i}_count" for i in (self._wiring.wheel_encoder, self._wiring.road_encoder))
        clock = [f"timer{self._wiring.timer}_value"] if self._clock else []
        return [self._logic.read.fields[name][0] for name in (*self._owned({}), *encoders, *clock)]

    def _warning(self, frame: bytes) -> str:
        """Return a warning about the outputs of a board that must not be written to."""
        table = self._logic.read
        try:
            values = table.decode_some(frame, (name for name in table.fields if name.endswith("_width")))
        except ProtocolError:  # another logic: where its widths are is not known
            return f". Whether its PWM outputs are zero is not known. {STILL_ON}"
        return f". ITS PWM OUTPUTS ARE NOT ZERO and stay as they are. {STILL_ON}" if any(values.values()) else ""

    def _prepare_image(self) -> None:
        self._settings, self._image[:] = self._first_image(self._read())
        self._pins = self._echoed_pins()
        if self._pins is not None:
            self._settings.pop("pin_output", None)  # every answer is compared with the last frame

    def _first_image(self, frame: bytes) -> tuple[dict[str, int], bytes]:
        """Return the decided fields for a board that reads `frame`, and the whole SEND frame, outputs off."""
        read, send = self._logic.read, self._logic.send
        try:
            found = read.decode(frame)
            settings = self._owned({name: int(found[name]) for name in _SHARED if name in found})
            return settings, sent_back(read, send, frame, settings, self._decided)
        except ProtocolError as error:
            raise BoardError(f"the board's settings cannot be kept: {error}") from error

    def first_write(self) -> list[PlannedWord]:
        """Return the words of the first frame that change, or that are kept though unknown."""
        frame = self._read()
        settings, image = self._first_image(frame)
        read, send = self._logic.read, self._logic.send
        number_word = self._number_at * BYTE_BITS // send.word_bits if self._number_at >= 0 else -1
        return list(planned_words(read, send, frame, image, settings, number_word))

    @property
    def safe_image(self) -> bytes:
        """The header of this board's answers, and the SEND frame with both widths zero."""
        image = bytearray(self._image)
        for place in (self._drive_out, self._brake_out):
            place.codec.pack_into(image, place.offset, 0)
        return self._header + bytes(image)

    def _load_safe_image(self, image: bytes) -> None:
        length = self._logic.header_bytes
        self._header, self._image[:] = image[:length], image[length:]
        self._pins = self._echoed_pins()
        self._late = True  # drops the other process's answers first, whatever their number

    def _echoed_pins(self) -> EchoedPins | None:
        """Return the pins of the image; None if the wiring has none."""
        logic, wiring = self._logic, self._wiring
        if not _latched(wiring):
            return None
        latch = int(logic.send.decode_some(self._image, ["pin_output"])["pin_output"])
        constant = _mask(self._constants.pins)
        return EchoedPins(logic.send, logic.read, latch, wiring.numbering_pins, wiring.watchdog_pin, constant)

    def exchange_parts(self) -> tuple[ExchangeConstants, ExchangeState] | None:
        """Return what `put_command` and `take_answer` work on after a good exchange.

        None for a board with a timer or pins in its wiring, or without numbers, and after a failed exchange.
        """
        if self._clock is not None or self._pins is not None or self._number_at < 0 or not self._good:
            return None
        wiring, send, read = self._wiring, self._logic.send, self._logic.read
        drive, brake = f"pwm{wiring.drive_pwm}_width", f"pwm{wiring.brake_pwm}_width"
        number = f"pwm{wiring.numbering_pwm}_prescaler"
        k = ExchangeConstants(
            self._full,
            self._numbers,
            wiring.wheel_sign,
            wiring.road_sign,
            send.bytes_of(drive),
            send.bytes_of(brake),
            first_word(send, number),
            read.bytes_of(drive),
            read.bytes_of(brake),
            first_word(read, number),
            read.bytes_of(f"encoder{wiring.wheel_encoder}_count"),
            read.bytes_of(f"encoder{wiring.road_encoder}_count"),
        )
        counts = *self._raw, self._wheel_count, self._road_count
        return k, ExchangeState(list(self._image), self._number, *counts, self._tick, self._newest_ns)

    def resume(self, s: ExchangeState, answer: bytes) -> None:
        """Go on after good exchanges of `exchange_parts`, of which `answer` is the newest answer."""
        self._image[:], self._number = bytes(s.frame), s.number
        self._raw, self._wheel_count, self._road_count = (s.wheel_raw, s.road_raw), s.wheel_count, s.road_count
        self._tick, self._newest_ns, self._newest_frame = s.tick, s.newest_ns, answer

    def _start(self) -> tuple[int, int]:
        frame = self._write_off()
        echo = self._logic.read.decode(frame)
        wrong = [f"{name} = {echo[name]}, not {value}" for name, value in self._settings.items() if echo[name] != value]
        if wrong:
            raise BoardError(f"the board did not take its settings: {'; '.join(wrong)}")
        return self._counts(frame)

    def _owned(self, found: Mapping[str, int]) -> dict[str, int]:
        """Return the fields that wiring and constants decide, given the board's pins and resets."""
        owned = self._of_wiring(found) | self._constants.fields
        if pins := self._constants.pins:
            levels = _mask(pin for pin, level in pins.items() if level)
            owned["pin_output"] = found.get("pin_output", 0) & ~_mask(pins) | levels
            owned["pin_direction"] &= ~_mask(pins)
        return owned

    def _of_wiring(self, found: Mapping[str, int]) -> dict[str, int]:
        """Return the fields that the wiring decides."""
        wiring = self._wiring
        channels = (wiring.drive_pwm, wiring.brake_pwm)
        numbering = (wiring.numbering_pwm,) if wiring.numbering_pwm >= 0 else ()
        ours = _mask((wiring.wheel_encoder, wiring.road_encoder))
        watchdog, contact = (
            _mask([pin] if pin >= 0 else []) for pin in (wiring.watchdog_pin, wiring.watchdog_contact_pin)
        )
        pins = {
            "pin_mode": (found.get("pin_mode", 0) | _functions(wiring)) & ~(watchdog | contact),
            "pin_direction": found.get("pin_direction", 0) & ~(_mask(wiring.pwm_pins) | watchdog) | contact,
            "encoder_reset": found.get("encoder_reset", 0) & ~ours,
        }
        owned = {
            **{f"pwm{channel}_width": 0 for channel in (*channels, *numbering)},
            **{f"pwm{channel}_mode": self._mode for channel in channels},
            **{f"pwm{channel}_prescaler": wiring.pwm_prescaler for channel in channels},
            **{name: value for name, value in pins.items() if name in self._logic.send.fields},
        }
        if wiring.timer >= 0:
            owned["timer_reset"] = found.get("timer_reset", 0) & ~(1 << wiring.timer)
            owned["timer_mode"] = found.get("timer_mode", 0) | 1 << wiring.timer
        return owned

    @property
    def engine(self) -> str:
        """The link's engine in use."""
        return self._link.engine

    @engine.setter
    def engine(self, engine: str) -> None:
        self._link.engine = engine

    def _transfer(self, command: Command) -> tuple[int, int]:
        self._wait_for(self._hurried_s if self.hurried else self._patient_s)
        drive, brake = widths(command, self._full)
        return self._counts(self._write_widths(drive, brake, beat=self.armed and self._good))

    @property
    def watchdog_closed(self) -> bool | None:
        """Whether the watchdog's contact was closed at the newest good exchange; None if the wiring has no watchdog."""
        if self._wiring.watchdog_pin < 0:
            return None
        levels = self._logic.read.decode_some(self._newest_frame, ["pin_input"])["pin_input"]
        return bool(int(levels) >> self._wiring.watchdog_contact_pin & 1)

    def _dated(self, now: int) -> int:
        return now if self._clock is None else self._taken_ns

    def _write_safe(self) -> None:
        self._wait_for(self._patient_s)  # no tick waits, and attempts are few
        self._write_off()

    def _write_off(self) -> bytes:
        """Hold the timer at zero with both widths zero, then write them with the timer released."""
        if self._clock is not None:
            self._link.write(self._held_at_zero())
            self._clock.restart(self._now_ns())
        self._start_ns = self._now_ns()
        return self._write_widths(0, 0)

    def _held_at_zero(self) -> bytearray:
        """Return the SAFE image with the timer held at zero."""
        image, reset = bytearray(self.safe_image[self._logic.header_bytes :]), self._logic.send.place("timer_reset")
        (others,) = reset.codec.unpack_from(image, reset.offset)
        reset.codec.pack_into(image, reset.offset, others | 1 << self._wiring.timer)
        return image

    def _wait_for(self, timeout_s: float) -> None:
        if timeout_s != self._timeout_s:
            self._timeout_s = self._link.timeout_s = timeout_s

    def _write_widths(self, drive: int, brake: int, *, beat: bool = False) -> bytes:
        """Send both widths, read, and check that the answer is this board's and echoes them."""
        image, logic, link = self._image, self._logic, self._link
        self._drive_out.codec.pack_into(image, self._drive_out.offset, drive)
        self._brake_out.codec.pack_into(image, self._brake_out.offset, brake)
        if self._number_at >= 0:
            self._number = (self._number + 1) % self._numbers
            self._number_word.pack_into(image, self._number_at, self._number)
        if self._pins is not None:
            self._pins.put_into(image, beat=beat)
        self._good = False
        late, self._late = self._late, True
        try:
            if late:
                link.write(image)
                # drop the answer of a failed exchange, after the output was written
                link.discard(len(image))
                answer = self._read()
            else:
                answer = self._whole(link.exchange(image, logic.request, logic.read.size))
            frame = self._newest(answer)
        except NoAnswerError:
            self._late = not self._knows_late
            raise
        echo = (
            self._drive_echo.codec.unpack_from(frame, self._drive_echo.offset)[0],
            self._brake_echo.codec.unpack_from(frame, self._brake_echo.offset)[0],
        )
        if echo != (drive, brake):
            raise LinkError(
                f"the board reports PWM widths {echo}, but {(drive, brake)} were sent: the frame is old, or another "
                "program drives the board"
            )
        self._late = False
        self._newest_frame = frame
        self._good = True
        return frame

    def _newest(self, frame: bytes) -> bytes:
        """Return the answer to the newest request, `frame` or a later one; drop older ones."""
        number = self._number_word
        for _ in range(_MOST_OLD):
            if not frame.startswith(self._header):
                raise LinkError("the answer's header is not this board's: the frame is damaged or the board was reset")
            at = self._number_echo
            numbered = at < 0 or number.unpack_from(frame, at)[0] % self._numbers == self._number
            if numbered and self._pins is not None:
                numbered = self._pins.echoed(frame)
            if numbered and self._date(frame):
                return frame
            try:
                frame = self._whole(self._link.read(self._logic.read.size))
            except LinkError as error:
                why = self._clock.fault if numbered and self._clock else "the answer is to an older request"
                raise type(error)(f"{why}; no newer one follows: {error}") from error
        raise LinkError("the board answers only old requests: is another program reading from it?")

    def _date(self, frame: bytes) -> bool:
        """Date the answer; return False if the board did not make it during this exchange."""
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
        self._link.write(self._logic.request)
        return self._whole(self._link.read(self._logic.read.size))

    def _whole(self, frame: bytes) -> bytes:
        size = self._logic.read.size
        if len(frame) != size:
            raise LinkError(f"the board's answer has {len(frame)} bytes, must be {size}: check the cable, avoid hubs")
        return frame

    def _close(self) -> None:
        self._link.close()


def widths(command: Command, full: int) -> tuple[int, int]:
    """Return the PWM widths of drive and brake; `full` is duty 1. Raises BoardError for a duty outside 0..1."""
    if not (0.0 <= command.drive <= 1.0 and 0.0 <= command.brake <= 1.0):  # NaN fails too
        raise BoardError(f"{command}: duties must be in 0..1")  # never masked
    return pwm_steps(command.drive, full), pwm_steps(command.brake, full)


def _require_channels(wiring: BoardConfig, logic: Logic) -> None:
    wanted = {
        "drive_pwm": f"pwm{wiring.drive_pwm}_width",
        "brake_pwm": f"pwm{wiring.brake_pwm}_width",
        "numbering_pwm": f"pwm{max(wiring.numbering_pwm, 0)}_prescaler",
        **({"timer": f"timer{wiring.timer}_value"} if wiring.timer >= 0 else {}),
        "wheel_encoder": f"encoder{wiring.wheel_encoder}_count",
        "road_encoder": f"encoder{wiring.road_encoder}_count",
    }
    mistakes = [
        ConfigIssue(f"board.{key}", f"{getattr(wiring, key)}: {logic.read.title} has no such channel")
        for key, name in wanted.items()
        if name not in logic.read.fields
    ]
    if _functions(wiring) and "pin_mode" not in logic.send.fields:
        key = "pwm_pins" if wiring.pwm_functions is None else "pwm_functions"
        problem = f"{logic.send.title} has no pin mode: set board.pwm_functions to []"
        mistakes.append(ConfigIssue(f"board.{key}", problem))
    mistakes += _pin_mistakes(wiring)
    if mistakes:
        raise ConfigError(mistakes)


def _functions(wiring: BoardConfig) -> int:
    """Return the bits to set in the pin mode."""
    return _mask(wiring.pwm_pins if wiring.pwm_functions is None else wiring.pwm_functions)


def _pin_mistakes(wiring: BoardConfig) -> Iterator[ConfigIssue]:
    """Yield pins with two uses, and a watchdog without contact."""
    constants = [int(key[3:]) for key in wiring.constants if key.startswith("pin") and key[3:].isdecimal()]
    used = {"pwm_pins": wiring.pwm_pins, "constants": constants, "numbering_pins": wiring.numbering_pins}
    used |= {key: [pin] for key in ("watchdog_pin", "watchdog_contact_pin") if (pin := getattr(wiring, key)) >= 0}
    owner: dict[int, str] = {}
    for key, pins in used.items():
        for pin in pins:
            if pin in owner:
                yield ConfigIssue(f"board.{key}", f"{pin}: already in board.{owner[pin]}")
            owner[pin] = key
    if (wiring.watchdog_pin >= 0) is not (wiring.watchdog_contact_pin >= 0):
        problem = "a watchdog is proven before each run by its contact: name both pins or neither (docs/watchdog.md)"
        yield ConfigIssue("board.watchdog_contact_pin", problem)


def _latched(wiring: BoardConfig) -> bool:
    """Return whether some pins change with the frames."""
    return bool(wiring.numbering_pins) or wiring.watchdog_pin >= 0


def _mask(bits: Iterable[int]) -> int:
    return sum(1 << bit for bit in set(bits))


def _first_byte(table: FrameTable, name: str) -> int:
    """Return the byte offset of a field's first word."""
    _, layout = table.fields[name]
    return (layout[0].word + table.data_from) * table.word_bits // 8


def _known(header: FrameTable) -> list[str]:
    return [name for name in ("logic_version", "application_name", "synthesis_date") if name in header.fields]
