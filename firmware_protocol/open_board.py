"""The open board's own logic: frames with length, sequence number and CRC over a byte stream, serial line or USB.

A frame is SYNC, kind, length of the payload, sequence number, payload and CRC; each kind has one length. `MESSAGES` has
a table of every kind, over its whole frame. Numbers are little-endian, text and hex digits in reading order.

The board also understands the frames of `rtdac_usb`, logic 0x0111. PROTOCOL.md has the rules for both, the states and
the timing. This package defines the logic, so that every field is confirmed.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from types import MappingProxyType
from typing import Final

from firmware_protocol.fields import (
    BYTE_BITS,
    Bits,
    Buffer,
    FrameField,
    FrameTable,
    Layout,
    ProtocolError,
    Value,
    ValueKind,
    words,
)

PROTOCOL_VERSION: Final = 1
LOGIC_VERSION: Final = 0x0B01

SYNC: Final = 0xA5
"""First byte of a frame. Its bit 7 is set, and it is not a command of logic 0x0111."""
HEAD_BYTES: Final = 4
"""SYNC, kind, length, sequence."""
CRC_BYTES: Final = 2
OVERHEAD_BYTES: Final = HEAD_BYTES + CRC_BYTES
MOST_PAYLOAD_BYTES: Final = 48
SILENCE_MS: Final = 2
"""Silence on the line after which the board drops an unfinished frame."""

CLOCK_HZ: Final = 1_000_000
COUNTERS: Final = 4
REPORTED_COUNTERS: Final = 2
"""Counters 0 and 1 are in every REPORT; STATUS has all."""
PWMS: Final = 2

WATCHDOG_MS: Final = (2, 100)
TICK_HZ: Final = (100, 4000)
"""Range of the tick's rate; 0 is polled mode, without tick."""
WATCHDOG_PERIODS: Final = 2
"""The watchdog lasts at least this many periods: one lost command does not trip it."""
VENDOR_WATCHDOG_MS: Final = 250
"""Watchdog of logic 0x0111, whose frames cannot set one: two and a half periods of a program that sends at 10 Hz."""
CHALLENGE_MASK: Final = 0x5AC3
"""ARM answers the challenge of STATUS with its exclusive or."""


class State(IntEnum):
    """State of the board."""

    IDLE = 0  # since reset: no watchdog is configured
    CONFIGURED = 1
    ARMED = 2  # widths may be on, the watchdog runs
    TRIPPED = 3  # outputs off until CLEAR and ARM


class Trip(IntEnum):
    """Reason of the newest trip; it stays until the next one or a reset."""

    NONE = 0  # since reset
    WATCHDOG = 1  # armed, and no valid COMMAND for watchdog_ms
    STOP_INPUT = 2  # armed, and an input of stop_pins was low
    VENDOR_WATCHDOG = 3  # logic 0x0111 had a width on, and no SEND came for 250 ms


class Refused(IntEnum):
    """Reason of a REFUSAL."""

    STATE = 1  # not allowed in this state
    VALUE = 2  # a value is out of range
    ANSWER = 3  # the answer does not match the challenge
    STOP_INPUT = 4  # an input of stop_pins is low
    OUTPUTS = 5  # logic 0x0111 has a width on


@dataclass(frozen=True, slots=True)
class Message:
    """One kind of frame."""

    name: str
    kind: int
    meaning: str
    table: FrameTable
    """Fields of the whole frame, `sequence` included."""
    codec: Struct
    """Packs and unpacks all of the payload, at `HEAD_BYTES`, without checks: for the loop."""

    @property
    def from_host(self) -> bool:
        """Whether the host sends it; else the board."""
        return self.kind < _BOARD_KINDS

    @property
    def payload_bytes(self) -> int:
        """Length of the payload."""
        return self.table.size - OVERHEAD_BYTES

    @property
    def payload(self) -> tuple[FrameField, ...]:
        """Fields of the payload, in order."""
        return tuple(field for field, _ in list(self.table.fields.values())[_HEAD_FIELDS:-1])

    def encode(self, values: Mapping[str, Value] | None = None, *, sequence: int = 0) -> bytes:
        """Return the frame; fields without a value are zero. Raises ProtocolError for a value that does not fit."""
        return sealed(self.table.encode({**(values or {}), "sequence": sequence}))

    def decode(self, frame: Buffer) -> dict[str, Value]:
        """Return the payload's fields and `sequence`; raises ProtocolError for a damaged frame or another kind."""
        found = self.table.decode(frame)
        if crc16(frame[1:-CRC_BYTES]) != found["crc"]:
            raise ProtocolError(f"{self.table.title}: CRC 0x{found['crc']:04X} does not match the bytes before it")
        return {name: value for name, value in found.items() if name not in _ENVELOPE}


def crc16(data: Buffer) -> int:
    """Return CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected; 0x29B1 for b"123456789"."""
    return crc_hqx(data, 0xFFFF)


def sealed(frame: Buffer) -> bytes:
    """Return the frame with the right CRC in its last two bytes."""
    body = bytes(frame[:-CRC_BYTES])
    return body + crc16(body[1:]).to_bytes(CRC_BYTES, "little")


_BOARD_KINDS: Final = 0x80
_HEAD_FIELDS: Final = 3
_ENVELOPE: Final = ("kind", "length", "crc")
_SOURCE: Final = "this table"
_WIDTHS: Final = {"u8": 1, "u16": 2, "u32": 4, "i32": 4, "text8": 8, "hex8": 8}
_CODES: Final = {"u8": "B", "u16": "H", "u32": "I", "i32": "i", "text8": "8s", "hex8": "8s"}
"""The struct module's codes, by form."""
_KINDS: Final = {"i32": ValueKind.SIGNED, "text8": ValueKind.TEXT, "hex8": ValueKind.HEX}


def _layout(form: str, byte: int) -> Layout:
    size = _WIDTHS[form]
    if form in {"text8", "hex8"}:  # in reading order: the value's last part is the first byte
        return tuple(Bits(byte + size - 1 - part, 0, BYTE_BITS, BYTE_BITS * part) for part in range(size))
    return words(byte, *(BYTE_BITS,) * size)


def _message(name: str, kind: int, meaning: str, *payload: tuple[str, str, str, str]) -> Message:
    """Return a message whose payload has these fields, in order: name, form, unit, meaning."""
    length = sum(_WIDTHS[form] for _, form, _, _ in payload)
    declared = [
        ("kind", "u8", "1", "kind of the frame"),
        ("length", "u8", "bytes", "length of the payload"),
        ("sequence", "u8", "1", "number that ties an answer to its question"),
        *payload,
        ("crc", "u16", "1", "CRC-16/CCITT-FALSE from kind to the payload's last byte"),
    ]
    fields, byte = [], 1
    for field, form, unit, what in declared:
        layout = _layout(form, byte)
        read, send = (None, layout) if kind < _BOARD_KINDS else (layout, None)
        value = _KINDS.get(form, ValueKind.UNSIGNED)
        fields.append((FrameField(field, what, unit, _SOURCE, read, send, value), layout))
        byte += _WIDTHS[form]
    table = FrameTable(
        f"open board's {name} frame",
        fields,
        size=byte,
        word_bits=BYTE_BITS,
        command=SYNC,
        fixed={"kind": kind, "length": length},
    )
    codec = Struct("<" + "".join(_CODES[form] for _, form, _, _ in payload))
    return Message(name, kind, meaning, table, codec)


_STATE: Final = ("state", "u8", "1", "0 idle, 1 configured, 2 armed, 3 tripped")
_TRIP: Final = ("trip", "u8", "1", "reason of the newest trip: 0 none, 1 watchdog, 2 stop input, 3 vendor's watchdog")
_LATE: Final = ("late", "u16", "ticks", "ticks since reset, while armed, to which no command of theirs had come; wraps")
_APPLIED: Final = tuple((f"width{i}", "u16", "1", f"PWM {i}: width in force") for i in range(PWMS))
_CLOCK_US: Final = "board's clock, wraps"


def _counts(number: int) -> Iterator[tuple[str, str, str, str]]:
    for i in range(number):
        yield f"count{i}", "i32", "counts", f"counter {i}, quadrature x4, wraps"


HELLO: Final = _message("HELLO", 0x01, "asks who is there; answer IDENTITY")
CONFIGURE: Final = _message(
    "CONFIGURE",
    0x02,
    "sets watchdog, tick and PWM; answer STATUS, or REFUSAL while armed or tripped",
    ("watchdog_ms", "u8", "ms", "2..100: time without a valid COMMAND after which the outputs go off"),
    ("tick_hz", "u16", "Hz", "100..4000, a divisor of 1000000: rate of the board's tick; 0: polled"),
    ("stop_pins", "u16", "bit mask", "input i must be high while armed; a low one trips the board"),
    ("pwm_mode", "u8", "1", "0: 255 steps a period, 1: 4095"),
    ("pwm_prescaler", "u16", "1", "PWM frequency = 40 MHz / ((prescaler + 1) * steps), as near as the chip comes"),
)
ARM: Final = _message(
    "ARM",
    0x03,
    "allows widths and starts watchdog and tick; answer STATUS or REFUSAL",
    ("answer", "u16", "1", "the challenge of STATUS, exclusive or 0x5AC3"),
)
COMMAND: Final = _message(
    "COMMAND",
    0x04,
    "sets both widths; answer REPORT, at the next tick or, without a running tick, at once",
    *(
        (f"width{i}", "u16", "1", f"PWM {i}: steps of a period at logic 1, 0..255 or 0..4095 by pwm_mode")
        for i in range(PWMS)
    ),
)
DISARM: Final = _message("DISARM", 0x05, "outputs off at once, in every state; answer STATUS")
QUERY: Final = _message("QUERY", 0x06, "asks for STATUS; changes nothing and feeds no watchdog")
CLEAR: Final = _message("CLEAR", 0x07, "ends the state tripped; answer STATUS or REFUSAL")

IDENTITY: Final = _message(
    "IDENTITY",
    0x81,
    "answers HELLO",
    ("logic_version", "u16", "raw", "0x0B01"),
    ("protocol", "u8", "1", "version of this protocol: 1"),
    ("name", "text8", "text", "name of the board"),
    ("date", "text8", "date", "day of the firmware's source, YYYYMMDD, so that a build can be repeated"),
    ("unique_id", "hex8", "1", "number of the chip"),
    ("clock_hz", "u32", "Hz", "rate of the board's clock: 1000000"),
    ("counters", "u8", "1", "number of counters: 4"),
    ("pwms", "u8", "1", "number of PWM outputs: 2"),
)
STATUS: Final = _message(
    "STATUS",
    0x83,
    "answers CONFIGURE, ARM, DISARM, QUERY and CLEAR",
    _STATE,
    _TRIP,
    ("challenge", "u16", "1", "challenge for ARM; another one after reset, ARM, DISARM and trip"),
    ("watchdog_ms", "u8", "ms", "as configured; 0 in state idle"),
    ("tick_hz", "u16", "Hz", "as configured"),
    ("stop_pins", "u16", "bit mask", "as configured"),
    *_APPLIED,
    *_counts(COUNTERS),
    ("clock", "u32", "us", f"{_CLOCK_US}: of the counts"),
    ("trips", "u16", "1", "trips since reset; wraps"),
    _LATE,
    ("bad_frames", "u16", "1", "damaged or unknown frames since reset; wraps"),
    ("refused", "u16", "1", "COMMANDs since reset that changed nothing, late ones included; wraps"),
    ("pins", "u16", "bit mask", "levels of the inputs"),
    ("pwm_mode", "u8", "1", "as configured"),
    ("pwm_prescaler", "u16", "1", "as configured"),
)
REPORT: Final = _message(
    "REPORT",
    0x84,
    "the sample of a tick, or the answer to a COMMAND without one",
    ("tick", "u32", "1", "number of the report since ARM, DISARM or CLEAR; the first is 0"),
    ("clock", "u32", "us", f"{_CLOCK_US}: of the instant at which the counts were taken"),
    *_counts(REPORTED_COUNTERS),
    ("width0", "u16", "1", "PWM 0: width in force from this instant on"),
    ("width1", "u16", "1", "PWM 1: likewise"),
    _STATE,
    _TRIP,
    ("applied", "u8", "1", "sequence of the COMMAND in force"),
    _LATE,
)
REFUSAL: Final = _message(
    "REFUSAL",
    0x8F,
    "answers a CONFIGURE, ARM or CLEAR that changed nothing",
    ("refused", "u8", "1", "kind of the refused frame"),
    ("reason", "u8", "1", "1 state, 2 value, 3 answer, 4 stop input low, 5 outputs of logic 0x0111 on"),
    _STATE,
    _TRIP,
)

MESSAGES: Final[Mapping[int, Message]] = MappingProxyType(
    {
        message.kind: message
        for message in (
            *(HELLO, CONFIGURE, ARM, COMMAND, DISARM, QUERY, CLEAR),
            *(IDENTITY, STATUS, REPORT, REFUSAL),
        )
    }
)
"""By kind."""


def decode(frame: Buffer) -> tuple[Message, dict[str, Value]]:
    """Return the message of a whole frame and its fields. Raises ProtocolError for a damaged or unknown one."""
    message = MESSAGES.get(frame[1]) if len(frame) > 1 else None
    if message is None:
        raise ProtocolError(f"{bytes(frame[:2]).hex(' ')}: not the beginning of an open board's frame")
    return message, message.decode(frame)


class Receiver:
    """Finds the frames of one direction in a byte stream, as both sides do.

    A byte that cannot belong to a frame ends it: a kind of the other direction or of none, or a length that is not the
    kind's. That byte is looked at again, as the first of a new frame. A frame with a wrong CRC is dropped whole.
    `bad_frames` counts both. Bytes between frames are not counted.
    """

    __slots__ = ("_arriving", "_from_host", "_size", "bad_frames")

    def __init__(self, *, from_host: bool) -> None:
        self.bad_frames = 0
        self._from_host = from_host
        self._arriving = bytearray()
        self._size = 0

    @property
    def unfinished(self) -> bool:
        """Whether a frame has begun."""
        return bool(self._arriving)

    def drop(self) -> None:
        """Drop an unfinished frame, after silence on the line."""
        if self._arriving:
            self.bad_frames += 1
            self._arriving.clear()

    def feed(self, data: Buffer) -> list[bytes]:
        """Receive bytes; return the whole, undamaged frames that end in them."""
        return [frame for byte in data if (frame := self.receive(byte))]

    def receive(self, byte: int) -> bytes:
        """Receive one byte; return the frame that it ends, or nothing."""
        arriving = self._arriving
        if not arriving:
            if byte == SYNC:
                arriving.append(byte)
            return b""
        arriving.append(byte)
        if len(arriving) == _HEAD_FIELDS - 1:
            message = MESSAGES.get(byte)
            if message is None or message.from_host is not self._from_host:
                return self._again(byte)
            self._size = message.table.size
        elif len(arriving) == _HEAD_FIELDS and byte != self._size - OVERHEAD_BYTES:
            return self._again(byte)
        elif len(arriving) == self._size:
            frame = bytes(arriving)
            arriving.clear()
            if crc16(frame[1:-CRC_BYTES]) == int.from_bytes(frame[-CRC_BYTES:], "little"):
                return frame
            self.bad_frames += 1
        return b""

    def _again(self, byte: int) -> bytes:
        """Drop the frame, and take the byte as the first of a new one."""
        self.drop()
        return self.receive(byte)


@dataclass(frozen=True, slots=True)
class Line:
    """A way to the board, with what its wire adds to a frame."""

    name: str
    bits_per_us: float
    """Bits per microsecond on the wire."""
    byte_bits: int
    """Bits that a byte takes."""
    transfer_bits: int
    """Bits that each transfer takes beside its data."""
    packet_bytes: int
    """Most data of one transfer; 0: no limit."""
    shared: bool
    """Whether both directions share the wire."""

    def microseconds(self, count: int) -> float:
        """Return how long `count` bytes take on the wire."""
        transfers = -(-count // self.packet_bytes) if self.packet_bytes else 1
        return (self.byte_bits * count + self.transfer_bits * transfers) / self.bits_per_us


LINES: Final = (
    *(
        Line(f"serial line, {baud} baud", baud / 1e6, 10, 0, 0, shared=False)
        for baud in (115_200, 460_800, 921_600, 1_000_000, 2_000_000, 3_000_000)
    ),
    Line("USB full speed", 12.0, 8, 8 * 13, 64, shared=True),
    Line("USB high speed", 480.0, 8, 8 * 55, 512, shared=True),
)
"""Serial lines take 10 bits for a byte: start, 8 data, stop. USB takes, beside the data of a bulk transfer, 13 bytes at
full speed and 55 at high speed (USB20 of docs/facts/sources.md); bit stuffing is not counted."""
