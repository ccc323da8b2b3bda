"""RT-DAC/USB2: SEND, READ request and READ answer, one after the other in each tick."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from firmware_protocol import ProtocolError
from firmware_protocol.rtdac_usb2 import (
    FRAME_BYTES,
    HEADER_BYTES,
    PWM_CHANNELS,
    PWM_FULL_WIDTH,
    READ,
    READ_REQUEST,
    SEND,
)
from inteco_abs.boards.board import STILL_ON, Board, Identity
from inteco_abs.boards.links import Link
from inteco_abs.config import BoardConfig
from inteco_abs.errors import BoardError, LinkError
from inteco_abs.signals import Command

_WORD: Final = struct.Struct("<H")
_EXACT: Final = 1e-9
"""Keeps a duty that is a whole number of widths from losing one to binary rounding."""
_MODES: Final = ("8-bit", "12-bit")
_NUMBERS: Final = 1 << 15
"""A prescaler's lower 15 bits travel in one word, the same one in both directions."""
_MOST_OLD: Final = 100
"""More answers to older requests than this are no leftover of a pause."""


class RtdacUsb2(Board):
    """The board behind `link`, wired as `wiring` says; see `Board` for what it promises.

    The output image is built once, when the board is opened: words that the wiring owns come from the wiring,
    all other words from the first read, all PWM widths are zero. In a tick only the two widths change, and the
    number of the frame, for which the prescaler of a PWM channel that is wired to nothing is used: the board echoes
    it, so that an answer to an older request, late or duplicated, is told from the one to this request.
    """

    def __init__(self, link: Link, wiring: BoardConfig, now_ns: Callable[[], int], period_ns: int) -> None:
        super().__init__(now_ns, period_ns)
        self._link = link
        self._wiring = wiring
        self._mode = _MODES.index(wiring.pwm_mode)
        self._full = PWM_FULL_WIDTH[self._mode]
        drive, brake = f"pwm{wiring.drive_pwm}_width", f"pwm{wiring.brake_pwm}_width"
        self._widths = drive, brake
        self._drive_out, self._brake_out = SEND.place(drive).offset, SEND.place(brake).offset
        self._drive_echo, self._brake_echo = READ.place(drive).offset, READ.place(brake).offset
        numbered = f"pwm{wiring.numbering_pwm}_prescaler"
        self._number = 0
        # its lower 15 bits stand in the same word both ways; in SEND, the next word has the rest
        self._number_at = READ.place(numbered).offset if wiring.numbering_pwm >= 0 else -1
        self._wheel_at = READ.place(f"encoder{wiring.wheel_encoder}_count")
        self._road_at = READ.place(f"encoder{wiring.road_encoder}_count")
        self._image = bytearray(FRAME_BYTES)
        self._settings: dict[str, int] = {}
        self._header = b""
        self._late = False  # whether an exchange failed, so that its answer may still come

    def identify(self) -> Identity:
        """Read the header once; nothing is written but the READ request."""
        if not self._ready:
            self._link.discard(FRAME_BYTES)  # what a program before this one has left
        frame = self._read()
        try:
            values = READ.decode_some(frame, ("logic_version", "application_name", "synthesis_date", *self._widths))
        except ProtocolError as error:
            raise LinkError(f"the board's answer is no READ frame: {error}") from error
        if not self._ready:  # an open board that now calls itself something else has been reset or replaced
            self._header = frame[:HEADER_BYTES]
        version, name = int(values["logic_version"]), str(values["application_name"])
        because = self._distrust(version, name)
        if because and any(values[width] for width in self._widths):
            because += f". ITS PWM OUTPUTS ARE NOT ZERO and stay as they are. {STILL_ON}"
        return Identity(version, name, str(values["synthesis_date"]), because)

    def _distrust(self, version: int, name: str) -> str:
        wiring = self._wiring
        if version != wiring.logic_version:
            return f"the board has logic 0x{version:04X}, the profile was made for 0x{wiring.logic_version:04X}"
        if name not in wiring.application_names:
            known = ", ".join(map(repr, wiring.application_names)) or "none yet"
            return f"the board's logic is named {name!r}, the profile knows {known}"
        if not wiring.verified_by:
            return "nobody has verified the profile's wiring on the rig (verified_by is empty)"
        return ""

    def _take_over(self) -> None:
        try:
            found = READ.decode(self._read())
            pins = {name: int(found[name]) for name in ("pin_mode", "pin_direction", "encoder_reset")}
            self._settings = self._owned(pins)
            self._image[:] = SEND.encode({**{name: found[name] for name in SEND.fields}, **self._settings})
        except ProtocolError as error:
            raise BoardError(f"the board's settings cannot be taken over: {error}") from error

    @property
    def safe_image(self) -> bytes:
        """The SEND frame with all widths zero."""
        image = bytearray(self._image)
        for offset in (self._drive_out, self._brake_out):
            _WORD.pack_into(image, offset, 0)
        return bytes(image)

    def _adopt(self, image: bytes) -> None:
        self._image[:] = image
        self._number = _NUMBERS // 2  # far from what the other process may have asked for last
        self._late = True

    def _start(self) -> tuple[int, int]:
        frame = self._write_widths(0, 0)
        echo = READ.decode(frame)
        wrong = [f"{name} = {echo[name]}, not {value}" for name, value in self._settings.items() if echo[name] != value]
        if wrong:
            raise BoardError(f"the board did not take its settings: {'; '.join(wrong)}")
        return self._counts(frame)

    def _owned(self, found: dict[str, int]) -> dict[str, int]:
        """What the wiring decides, given the pins and resets as the board has them."""
        wiring = self._wiring
        pins = sum(1 << pin for pin in set(wiring.pwm_pins))
        encoders = 1 << wiring.wheel_encoder | 1 << wiring.road_encoder
        return {
            **{f"pwm{channel}_width": 0 for channel in range(PWM_CHANNELS)},
            **{f"pwm{channel}_mode": self._mode for channel in (wiring.drive_pwm, wiring.brake_pwm)},
            **{f"pwm{channel}_prescaler": wiring.pwm_prescaler for channel in (wiring.drive_pwm, wiring.brake_pwm)},
            "pin_mode": found["pin_mode"] | pins,
            "pin_direction": found["pin_direction"] & ~pins,
            "encoder_reset": found["encoder_reset"] & ~encoders,
        }

    def _transfer(self, command: Command) -> tuple[int, int]:
        if not (0.0 <= command.drive <= 1.0 and 0.0 <= command.brake <= 1.0):  # NaN fails too
            raise BoardError(f"{command}: duties must be in 0..1")  # never masked into something else
        full = self._full
        # rounded down: the output is never more than what the guard has admitted
        drive, brake = int(command.drive * full + _EXACT), int(command.brake * full + _EXACT)
        return self._counts(self._write_widths(drive, brake))

    def _write_safe(self) -> None:
        self._write_widths(0, 0)

    def _write_widths(self, drive: int, brake: int) -> bytes:
        """SEND both widths, READ, and check that the answer is this board's and echoes them."""
        _WORD.pack_into(self._image, self._drive_out, drive)
        _WORD.pack_into(self._image, self._brake_out, brake)
        if self._number_at >= 0:
            self._number = (self._number + 1) % _NUMBERS
            _WORD.pack_into(self._image, self._number_at, self._number)
        if self._late:
            self._link.write(self._image)
            # the answer of a failed exchange must not be taken for this one's; the output has gone out before
            self._link.discard(FRAME_BYTES)
            answer = self._read()
        else:
            self._late = True
            answer = _whole(self._link.exchange(self._image, READ_REQUEST, FRAME_BYTES))
        frame = self._newest(answer)
        echo = (_WORD.unpack_from(frame, self._drive_echo)[0], _WORD.unpack_from(frame, self._brake_echo)[0])
        if echo != (drive, brake):
            raise LinkError(
                f"the board reports PWM widths {echo}, sent were {(drive, brake)}: an old frame, or another master"
            )
        self._late = False
        return frame

    def _newest(self, frame: bytes) -> bytes:
        """The answer to the newest request, `frame` or one that follows it; older ones are dropped."""
        for _ in range(_MOST_OLD):
            if not frame.startswith(self._header):
                raise LinkError("the answer's header is not this board's: the frame is damaged or the board was reset")
            if self._number_at < 0 or _WORD.unpack_from(frame, self._number_at)[0] % _NUMBERS == self._number:
                return frame
            frame = _whole(self._link.read(FRAME_BYTES))
        raise LinkError("the board answers only requests of long ago: is another program reading from it?")

    def _counts(self, frame: bytes) -> tuple[int, int]:
        (wheel,) = self._wheel_at.codec.unpack_from(frame, self._wheel_at.offset)
        (road,) = self._road_at.codec.unpack_from(frame, self._road_at.offset)
        return self._wiring.wheel_sign * wheel, self._wiring.road_sign * road

    def _read(self) -> bytes:
        self._link.write(READ_REQUEST)
        return _whole(self._link.read(FRAME_BYTES))

    def _close(self) -> None:
        self._link.close()


def _whole(frame: bytes) -> bytes:
    if len(frame) != FRAME_BYTES:
        raise LinkError(f"the board's answer has {len(frame)} bytes, must be {FRAME_BYTES}")
    return frame
