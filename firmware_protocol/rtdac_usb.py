"""RT-DAC/USB, first generation: 150-byte frames through an FTDI FIFO, logics 0x0111 and 0x0112.

The host sends a command byte and data, or a READ request that the board answers with 150 bytes. Data bytes from
the board use all 8 bits; in bytes to the board bit 7 marks a command, so values are split into parts of 7 bits, and the
PWM mode moves from bit 0 (READ) to bit 6 (SEND) of its byte, above the prescaler's two top bits.

Data bytes have the same number in both directions: data byte n is byte n of a READ frame, and byte n + 1 of a SEND
frame, behind the command. The two logics agree in bytes 0 to 30, except the number of pin modes, and above 92.

All facts come from the vendor's C library for this board (docs/facts/sources.md#s2). A field is marked inferred if its
place is known but not all of its meaning.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

from firmware_protocol.fields import (
    BYTE_BITS,
    Bits,
    Buffer,
    FrameField,
    FrameTable,
    Layout,
    Logic,
    ProtocolError,
    Status,
    Value,
    ValueKind,
    bits,
    words,
)

FRAME_BYTES: Final = 150
"""Length of a READ answer, and of a SEND frame with its command byte."""
HEADER_BYTES: Final = 8
"""Bytes 0 to 7 of a READ frame: logic version and name, constant on a given board, the same in every logic."""
DUMMY: Final = b"\x80"
"""Leaves the mode in which the FPGA is programmed; sent once after opening. No reply."""
SEND_COMMAND: Final = 0x81
READ_REQUEST: Final = b"\x82"
SEND_AND_READ_COMMAND: Final = 0x83
"""Named by the vendor but used by no known program: inferred, and not used here."""

LATENCY_TIMER_MS: Final = 1
"""Latency timer that the vendor's library sets in the FTDI chip on opening, after a reset."""
EVENT_CHARACTER: Final = 0x3F
"""Event character that the library enables then. It disables the error character and sets no baud rate."""

_RAW: Final = "raw"
_BITMAP: Final = "bit mask"
_HELD: Final = "reset bit i; that counter i is held at 0 while it is 1, as on RT-DAC/USB2, is inferred"
_PAYLOAD_BITS: Final = 7
_U16: Final = (8, 8)
_U32: Final = (8, 8, 8, 8)
_INFERRED: Final = Status.INFERRED
_field: Final = partial(FrameField, source="S2")


def _both(name: str, meaning: str, unit: str, layout: Layout, status: Status = Status.CONFIRMED) -> FrameField:
    return _field(name, meaning, unit, read=layout, send=layout, status=status)


_HEADER: Final = (
    _field("logic_version", "version of the FPGA logic; shown in hex", _RAW, read=words(0, *_U16)),
    _field(
        "application_name",
        "name of the logic; its last character travels first",
        "text",
        read=words(3, 8, 8, 8, 8, 8),
        kind=ValueKind.TEXT,
    ),
)


def _pins(name: str, meaning: str, byte: int, status: Status = Status.CONFIRMED) -> FrameField:
    return _field(name, meaning, _BITMAP, read=words(byte, 8, 8, 8, 2), send=words(byte, 7, 7, 7, 5), status=status)


def _digital(modes: int) -> list[FrameField]:
    mode = "CN1 pin mode bits; that 1 = function (PWM) is inferred, which pins they are is unknown"
    return [
        _both("pin_mode", mode, _BITMAP, bits(8, 0, modes), _INFERRED),
        _pins("pin_direction", "CN1 pin direction: 1 = input, 0 = output", 9, _INFERRED),
        _pins("pin_output", "CN1 output latch: 1 = high", 13),
        _field("pin_input", "CN1 input levels", _BITMAP, read=words(17, 8, 8, 8, 2)),
    ]


def _pwm(i: int) -> list[FrameField]:
    byte = 21 + 5 * i
    divider = f"PWM {i}: clock divider minus one; frequency = 40 MHz / ((prescaler + 1) * 255 or 4095), inferred"
    cut = (Bits(byte, 0, 7, 0), Bits(byte + 1, 0, 7, 7), Bits(byte + 2, 0, 2, 14))
    mode, send_mode = bits(byte + 2, 0, 1), bits(byte + 2, 6, 1)
    width, part = words(byte + 3, 8, 4), f"PWM {i}: part of the period at logic 1, of 255 or 4095"
    return [
        _field(f"pwm{i}_prescaler", divider, "1", read=words(byte, *_U16), send=cut),
        _field(f"pwm{i}_mode", f"PWM {i}: 0 = 8-bit, 1 = 12-bit", "1", read=mode, send=send_mode),
        _field(f"pwm{i}_width", part, "1", read=width, send=words(byte + 3, 7, 5)),
    ]


def _count(i: int, byte: int, status: Status = Status.CONFIRMED) -> FrameField:
    meaning = f"encoder {i}: 32-bit quadrature counter (x4), wraps; two's complement in the vendor's library"
    read = words(byte, *_U32)
    return _field(f"encoder{i}_count", meaning, "counts", read=read, kind=ValueKind.SIGNED, status=status)


def _encoders_with_index() -> list[FrameField]:
    return [
        _both("encoder_reset", _HELD, _BITMAP, bits(41, 0, 4), _INFERRED),
        _both("encoder_index_active", "index input i is used", _BITMAP, bits(42, 0, 4)),
        _both("encoder_index_invert", "index input i is inverted", _BITMAP, bits(43, 0, 4)),
        *(_count(i, 44 + 5 * i) for i in range(4)),
    ]


def _timers() -> list[FrameField]:
    values = (words(66 + 5 * i, *_U32) for i in range(2))
    return [
        _both("timer_reset", _HELD, _BITMAP, bits(64, 0, 2), _INFERRED),
        _both("timer_mode", "timer/counter i: 0 = counter, 1 = timer", _BITMAP, bits(65, 0, 2), _INFERRED),
        *(_field(f"timer{i}_value", f"timer/counter {i}, wraps", "1", read=value) for i, value in enumerate(values)),
    ]


def _generator() -> list[FrameField]:
    flags = (
        ("enable", "enable"),
        ("hardware_select", "start and gate by hardware or software; which value is which is unknown"),
        ("software_gate", "software gate"),
        ("software_start", "software start"),
        ("gate_invert", "gate is inverted"),
        ("start_invert", "start is inverted"),
        ("infinite", "runs without end"),
    )
    levels = (("level", "level in state 1"), ("initial_level", "level before"), ("terminate_level", "level after"))
    numbers = (("length1", "length of state 1"), ("length2", "length of state 2"), ("periods", "number of periods"))
    switches = [
        _both(f"generator_{name}", f"generator: {what}", "1", bits(byte, i, 1))
        for byte, group in ((76, flags), (77, levels))
        for i, (name, what) in enumerate(group)
    ]
    for i, (name, what) in enumerate(numbers):
        read, send = words(78 + 5 * i, *_U32), words(78 + 5 * i, 7, 7, 7, 7, 4)
        switches.append(_field(f"generator_{name}", f"generator: {what}", "1", read=read, send=send))
    return switches


def _analogue() -> list[FrameField]:
    gain = "gain code 0..4 = x1, x2, x4, x8, x16; that the even channel has the low bits is inferred"
    result = "as it travels; that bits 0 to 11 are two's complement, as on RT-DAC/USB2, is inferred"
    output = "14 bits; volts = -10 + 20 * code / 16383, as on RT-DAC/USB2, is inferred"
    gains = ((i, bits(93 + i // 2, 4 * (i % 2), 3)) for i in range(16))
    outputs = ((i, words(133 + 2 * i, 8, 6), words(133 + 2 * i, 7, 7)) for i in range(4))
    return [
        *(_both(f"ad{i}_gain", f"A/D {i} {gain}", "1", place, _INFERRED) for i, place in gains),
        *(_field(f"ad{i}_result", f"A/D {i} {result}", _RAW, read=words(101 + 2 * i, *_U16)) for i in range(16)),
        *(_field(f"da{i}_output", f"D/A {i}, {output}", "1", read=read, send=send) for i, read, send in outputs),
    ]


_FIELDS_0111: Final = (
    *_HEADER,
    *_digital(modes=5),
    *(field for i in range(4) for field in _pwm(i)),
    *_encoders_with_index(),
    *_timers(),
    *_generator(),
    *_analogue(),
)
_FIELDS_0112: Final = (
    *_HEADER,
    *_digital(modes=2),
    *(field for i in range(2) for field in _pwm(i)),
    _field("encoder_reset", _HELD, _BITMAP, read=words(31, 8, 4), send=words(31, 7, 5), status=_INFERRED),
    *(_count(i, 33 + 4 * i, _INFERRED) for i in range(12)),
    *_analogue(),
)


def _logic(version: int, fields: tuple[FrameField, ...]) -> Logic:
    name = f"logic 0x{version:04X}"
    bytes_of = partial(FrameTable.of, fields, size=FRAME_BYTES, word_bits=BYTE_BITS)
    read = bytes_of(f"RT-DAC/USB READ frame, {name}", fixed={"logic_version": version})
    send = bytes_of(f"RT-DAC/USB SEND frame, {name}", payload_bits=_PAYLOAD_BITS, command=SEND_COMMAND, data_from=1)
    return Logic(name, fields, read, send, HEADER, HEADER_BYTES, READ_REQUEST)


HEADER: Final = FrameTable.of(_HEADER, "RT-DAC/USB READ frame", size=FRAME_BYTES, word_bits=BYTE_BITS)
"""The part of a READ frame that identifies its logic; the same in all logics."""

LOGICS: Final[Mapping[int, Logic]] = MappingProxyType(
    {version: _logic(version, fields) for version, fields in ((0x0111, _FIELDS_0111), (0x0112, _FIELDS_0112))}
)
"""By logic version."""


def logic_of(version: int) -> Logic:
    """Return the tables of a logic; raises ProtocolError for an unknown version, with the known ones."""
    found = LOGICS.get(version)
    if found is None:
        shown = f"0x{version:04X}" if type(version) is int else repr(version)
        raise ProtocolError(f"logic = {shown}: must be one of {', '.join(f'0x{known:04X}' for known in LOGICS)}")
    return found


def encode_send(values: Mapping[str, Value], *, logic: int) -> bytes:
    """Return the SEND frame with `values`; other fields are zero. Raises ProtocolError."""
    return logic_of(logic).send.encode(values)


def decode_read(frame: Buffer, *, logic: int) -> dict[str, Value]:
    """Return all fields of a READ frame of this logic. Raises ProtocolError."""
    return logic_of(logic).read.decode(frame)


def encode_read(values: Mapping[str, Value], *, logic: int) -> bytes:
    """Return the board's READ frame with its logic version and `values`. Raises ProtocolError."""
    return logic_of(logic).read.encode(values)


def decode_send(frame: Buffer, *, logic: int) -> dict[str, Value]:
    """Return all fields of a SEND frame. Raises ProtocolError."""
    return logic_of(logic).send.decode(frame)
