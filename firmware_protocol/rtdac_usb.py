"""RT-DAC/USB, first generation: 150-byte frames through an FTDI FIFO, logics 0x0111 and 0x0112.

The host sends a command byte and data, or a READ request that the board answers with 150 bytes. Data bytes from
the board use all 8 bits; towards the board bit 7 marks a command, so values are cut in sevens, and the PWM mode
moves from bit 0 (READ) to bit 6 (SEND) of its byte, above the prescaler's two top bits.

Data bytes have the same number in both directions: data byte n is byte n of a READ frame, and byte n + 1 of a SEND
frame, behind the command. The two logics agree in bytes 0 to 30, but for the number of pin modes, and above 92.

All facts come from the vendor's C library for this board (docs/facts/sources.md#s2). A field is
marked inferred where its place is known but not all of its meaning.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from firmware_protocol.fields import (
    BYTE_BITS,
    Bits,
    Buffer,
    Field,
    FrameTable,
    Kind,
    Layout,
    ProtocolError,
    Status,
    Value,
    bits,
    words,
)
from firmware_protocol.pwm import PWM_CLOCK_HZ, PWM_FULL_WIDTH, pwm_frequency_hz

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
"""What the vendor's library sets in the FTDI chip on opening, after a reset."""
EVENT_CHARACTER: Final = 0x3F
"""The same: the event character that it enables. It turns the error character off and sets no baud rate."""

_SOURCE: Final = "S2"
_RAW: Final = "raw"
_BITMAP: Final = "bit mask"
_HELD: Final = "reset bit i; that counter i is held at 0 while it is 1, as on RT-DAC/USB2, is inferred"
_PAYLOAD_BITS: Final = 7
_U16: Final = (8, 8)
_U32: Final = (8, 8, 8, 8)


def _both(name: str, meaning: str, unit: str, layout: Layout, status: Status = Status.CONFIRMED) -> Field:
    return Field(name, meaning, unit, _SOURCE, read=layout, send=layout, status=status)


def _header() -> list[Field]:
    return [
        Field("logic_version", "version of the FPGA logic; shown in hex", _RAW, _SOURCE, read=words(0, *_U16)),
        Field(
            "application_name",
            "name of the logic; its last character travels first",
            "text",
            _SOURCE,
            read=words(3, 8, 8, 8, 8, 8),
            kind=Kind.TEXT,
        ),
    ]


def _pins(name: str, meaning: str, byte: int, status: Status = Status.CONFIRMED) -> Field:
    return Field(
        name, meaning, _BITMAP, _SOURCE, read=words(byte, 8, 8, 8, 2), send=words(byte, 7, 7, 7, 5), status=status
    )


def _digital(modes: int) -> list[Field]:
    return [
        _both(
            "pin_mode",
            "CN1 pin mode bits; that 1 = function (PWM) is inferred, which pins they are is unknown",
            _BITMAP,
            bits(8, 0, modes),
            Status.INFERRED,
        ),
        _pins("pin_direction", "CN1 pin direction: 1 = input, 0 = output", 9, Status.INFERRED),
        _pins("pin_output", "CN1 output latch: 1 = high", 13),
        Field("pin_input", "CN1 input levels", _BITMAP, _SOURCE, read=words(17, 8, 8, 8, 2)),
    ]


def _pwm(i: int) -> list[Field]:
    byte = 21 + 5 * i
    return [
        Field(
            f"pwm{i}_prescaler",
            f"PWM {i}: clock divider minus one; frequency = 40 MHz / ((prescaler + 1) * 255 or 4095), inferred",
            "1",
            _SOURCE,
            read=words(byte, *_U16),
            send=(Bits(byte, 0, 7, 0), Bits(byte + 1, 0, 7, 7), Bits(byte + 2, 0, 2, 14)),
        ),
        Field(
            f"pwm{i}_mode",
            f"PWM {i}: 0 = 8-bit, 1 = 12-bit",
            "1",
            _SOURCE,
            read=bits(byte + 2, 0, 1),
            send=bits(byte + 2, 6, 1),
        ),
        Field(
            f"pwm{i}_width",
            f"PWM {i}: part of the period at logic 1, of 255 or 4095",
            "1",
            _SOURCE,
            read=words(byte + 3, 8, 4),
            send=words(byte + 3, 7, 5),
        ),
    ]


def _count(i: int, byte: int, status: Status = Status.CONFIRMED) -> Field:
    return Field(
        f"encoder{i}_count",
        f"encoder {i}: 32-bit quadrature counter (x4), wraps; two's complement in the vendor's library",
        "counts",
        _SOURCE,
        read=words(byte, *_U32),
        kind=Kind.SIGNED,
        status=status,
    )


def _encoders_with_index() -> list[Field]:
    return [
        _both("encoder_reset", _HELD, _BITMAP, bits(41, 0, 4), Status.INFERRED),
        _both("encoder_index_active", "index input i is used", _BITMAP, bits(42, 0, 4)),
        _both("encoder_index_invert", "index input i is inverted", _BITMAP, bits(43, 0, 4)),
        *(_count(i, 44 + 5 * i) for i in range(4)),
    ]


def _timers() -> list[Field]:
    return [
        _both("timer_reset", _HELD, _BITMAP, bits(64, 0, 2), Status.INFERRED),
        _both("timer_mode", "timer/counter i: 0 = counter, 1 = timer", _BITMAP, bits(65, 0, 2), Status.INFERRED),
        *(
            Field(f"timer{i}_value", f"timer/counter {i}, wraps", "1", _SOURCE, read=words(66 + 5 * i, *_U32))
            for i in range(2)
        ),
    ]


def _generator() -> list[Field]:
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
    return [
        *(
            _both(f"generator_{name}", f"generator: {what}", "1", bits(76, i, 1))
            for i, (name, what) in enumerate(flags)
        ),
        *(
            _both(f"generator_{name}", f"generator: {what}", "1", bits(77, i, 1))
            for i, (name, what) in enumerate(levels)
        ),
        *(
            Field(
                f"generator_{name}",
                f"generator: {what}",
                "1",
                _SOURCE,
                read=words(78 + 5 * i, *_U32),
                send=words(78 + 5 * i, 7, 7, 7, 7, 4),
            )
            for i, (name, what) in enumerate(numbers)
        ),
    ]


def _analogue() -> list[Field]:
    return [
        *(
            _both(
                f"ad{i}_gain",
                f"A/D {i} gain code 0..4 = x1, x2, x4, x8, x16; that the even channel has the low bits is inferred",
                "1",
                bits(93 + i // 2, 4 * (i % 2), 3),
                Status.INFERRED,
            )
            for i in range(16)
        ),
        *(
            Field(
                f"ad{i}_result",
                f"A/D {i} as it travels; that bits 0 to 11 are two's complement, as on RT-DAC/USB2, is inferred",
                _RAW,
                _SOURCE,
                read=words(101 + 2 * i, *_U16),
            )
            for i in range(16)
        ),
        *(
            Field(
                f"da{i}_output",
                f"D/A {i}, 14 bits; volts = -10 + 20 * code / 16383, as on RT-DAC/USB2, is inferred",
                "1",
                _SOURCE,
                read=words(133 + 2 * i, 8, 6),
                send=words(133 + 2 * i, 7, 7),
            )
            for i in range(4)
        ),
    ]


def _fields_0111() -> tuple[Field, ...]:
    return (
        *_header(),
        *_digital(modes=5),
        *(field for i in range(4) for field in _pwm(i)),
        *_encoders_with_index(),
        *_timers(),
        *_generator(),
        *_analogue(),
    )


def _fields_0112() -> tuple[Field, ...]:
    reset = Field(
        "encoder_reset", _HELD, _BITMAP, _SOURCE, read=words(31, 8, 4), send=words(31, 7, 5), status=Status.INFERRED
    )
    return (
        *_header(),
        *_digital(modes=2),
        *(field for i in range(2) for field in _pwm(i)),
        reset,
        *(_count(i, 33 + 4 * i, Status.INFERRED) for i in range(12)),
        *_analogue(),
    )


class Logic(NamedTuple):
    """What the wire carries under one logic of the FPGA."""

    version: int
    fields: tuple[Field, ...]
    read: FrameTable
    send: FrameTable
    pwm_channels: int
    encoder_channels: int


def _logic(version: int, fields: tuple[Field, ...]) -> Logic:
    name = f"logic 0x{version:04X}"
    return Logic(
        version,
        fields,
        FrameTable(
            f"RT-DAC/USB READ frame, {name}",
            ((f, f.read) for f in fields if f.read is not None),
            size=FRAME_BYTES,
            word_bits=BYTE_BITS,
            fixed={"logic_version": version},
        ),
        FrameTable(
            f"RT-DAC/USB SEND frame, {name}",
            ((f, f.send) for f in fields if f.send is not None),
            size=FRAME_BYTES,
            word_bits=BYTE_BITS,
            payload_bits=_PAYLOAD_BITS,
            command=SEND_COMMAND,
            data_from=1,
        ),
        sum(f.name.endswith("_width") for f in fields),
        sum(f.name.endswith("_count") for f in fields),
    )


LOGICS: Final[Mapping[int, Logic]] = MappingProxyType(
    {0x0111: _logic(0x0111, _fields_0111()), 0x0112: _logic(0x0112, _fields_0112())}
)
"""By logic version."""

HEADER: Final = FrameTable(
    "RT-DAC/USB READ frame",
    ((f, f.read) for f in _header() if f.read is not None),
    size=FRAME_BYTES,
    word_bits=BYTE_BITS,
)
"""The part of a READ frame that tells which logic it comes from; any logic."""


def logic_of(version: int) -> Logic:
    """The tables of a logic; raises ProtocolError for one that is not known, naming those that are."""
    found = LOGICS.get(version)
    if found is None:
        shown = f"0x{version:04X}" if type(version) is int else repr(version)
        raise ProtocolError(f"logic = {shown}: must be one of {', '.join(f'0x{known:04X}' for known in LOGICS)}")
    return found


def decode_header(frame: Buffer) -> dict[str, Value]:
    """Logic version and application name of a READ frame of any logic. Raises ProtocolError."""
    return HEADER.decode(frame)


def encode_send(values: Mapping[str, Value], *, logic: int) -> bytes:
    """SEND frame that the host writes; fields not named are zero. Raises ProtocolError."""
    return logic_of(logic).send.encode(values)


def decode_read(frame: Buffer, *, logic: int) -> dict[str, Value]:
    """All fields of a READ frame that a board with this logic answered. Raises ProtocolError."""
    return logic_of(logic).read.decode(frame)


def encode_read(values: Mapping[str, Value], *, logic: int) -> bytes:
    """READ frame as the board makes it, with its logic version; fields not named are zero. Raises ProtocolError."""
    return logic_of(logic).read.encode(values)


def decode_send(frame: Buffer, *, logic: int) -> dict[str, Value]:
    """All fields of a SEND frame as the board understands it. Raises ProtocolError."""
    return logic_of(logic).send.decode(frame)


__all__ = [
    "DUMMY",
    "FRAME_BYTES",
    "HEADER",
    "LOGICS",
    "PWM_CLOCK_HZ",
    "PWM_FULL_WIDTH",
    "READ_REQUEST",
    "Logic",
    "ProtocolError",
    "decode_header",
    "decode_read",
    "decode_send",
    "encode_read",
    "encode_send",
    "logic_of",
    "pwm_frequency_hz",
]
