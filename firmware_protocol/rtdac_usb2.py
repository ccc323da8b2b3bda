"""RT-DAC/USB2: 504-byte frames of 16-bit words, defined by the logic in the board's FPGA.

The host sends a whole SEND frame, or a READ request that the board answers with one READ frame. READ words use
all 16 bits; in SEND words bit 15 marks a command and stays 0 in data, so values wider than 15 bits are split
differently by direction, and the PWM mode moves from bit 0 (READ) to bit 1 (SEND) of its word.

`LOGICS` has the tables of each known logic. The generic logic (0x0103) is published completely, in S1. Three logics
that the vendor ships with its rigs are known in part: servo (S5), TRAS (S4) and rpend (S10). The logic of the ABS rig
is not published: its table has what those three share. `sent_back` writes the words that no table names. Offsets above
word 106 depend on the logic version.

Sources: S1, S4, S5 and S10 of docs/facts/sources.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Final

from firmware_protocol.fields import (
    Bits,
    Buffer,
    FrameField,
    FrameTable,
    Layout,
    Logic,
    Status,
    Value,
    ValueKind,
    bits,
    words,
)

FRAME_BYTES: Final = 504
HEADER_BYTES: Final = 18
"""Words 0 to 8 of a READ frame: logic version, name, date and channel counts, constant on a given board."""
READ_COMMAND: Final = 0x8FFF
SEND_COMMAND: Final = 0x8F0F
READ_REQUEST: Final = READ_COMMAND.to_bytes(2, "little") + b"\0\0"
"""Command word 0x8FFF and padding: the bridge needs at least four bytes (S1)."""

LOGIC_VERSION: Final = 0x0103
ENDPOINT_OUT: Final = 0x02
"""Bulk OUT: commands and data to the FPGA. 0x06 programs the FPGA over JTAG and is never used."""
ENDPOINT_IN: Final = 0x84
"""Bulk IN: data from the FPGA. 0x88 is JTAG and is never used."""
PWM_CHANNELS: Final = 8
ENCODER_CHANNELS: Final = 8
TIMER_HZ: Final = 20_000_000
"""Rate of a timer/counter in timer mode, in all three rig logics whose drivers are public (S4, S5, rpend)."""

_RAW: Final = "raw"
_BITMAP: Final = "bit mask"
_field: Final = partial(FrameField, source="S1")


def _both(name: str, meaning: str, unit: str, layout: Layout) -> FrameField:
    return _field(name, meaning, unit, read=layout, send=layout)


def _header() -> list[FrameField]:
    """Return the fields of words 0 to 8, which are the same in every logic."""
    channels = (
        (6, ("pwm", "encoder", "encoder_index", "timer")),
        (7, ("counter", "timer_counter", "pulse_generator", "frequency_meter")),
        (8, ("chronometer",)),
    )
    places = ((what, bits(word, 4 * i, 4)) for word, names in channels for i, what in enumerate(names))
    name, name_at = "name of the logic; its last character travels first", words(1, 16, 16, 16)
    date = "day the logic was made; the hex digits read YYYYMMDD"
    further = "three more counts of channels, which ones is not published"
    return [
        _field("logic_version", "version of the FPGA logic; shown in hex", _RAW, read=bits(0, 0, 16)),
        _field("application_name", name, "text", read=name_at, kind=ValueKind.TEXT),
        _field("synthesis_date", date, "date", read=words(4, 16, 16), kind=ValueKind.HEX),
        *(
            _field(f"{what}_channels", f"number of {what.replace('_', ' ')} channels", "1", read=place)
            for what, place in places
        ),
        FrameField("further_counts", further, _RAW, "S4", bits(8, 4, 12)),
    ]


def _digital(*, mode: bool = True) -> list[FrameField]:
    """Return the fields of CN1; `mode` is whether the logic's pins have several functions."""

    def pins(name: str, meaning: str, word: int) -> FrameField:
        return _field(name, meaning, _BITMAP, read=words(word, 16, 10), send=words(word, 15, 11))

    return [
        *([pins("pin_mode", "CN1 pin mode: 0 = general purpose, 1 = function (PWM)", 10)] if mode else []),
        pins("pin_direction", "CN1 pin direction: 1 = input, 0 = output", 12),
        pins("pin_output", "CN1 output latch: 1 = high", 14),
        _field("pin_input", "CN1 input levels", _BITMAP, read=words(16, 16, 10)),
    ]


def _pwm(i: int) -> list[FrameField]:
    word = 20 + 3 * i
    divider = f"PWM {i}: clock divider minus one; frequency = 40 MHz / ((prescaler + 1) * 255 or 4095)"
    cut = (Bits(word, 0, 15, 0), Bits(word + 1, 0, 1, 15))
    mode, send_mode = bits(word + 1, 0, 1), bits(word + 1, 1, 1)
    part = f"PWM {i}: part of the period at logic 1, of 255 or 4095"
    return [
        _field(f"pwm{i}_prescaler", divider, "1", read=bits(word, 0, 16), send=cut),
        _field(f"pwm{i}_mode", f"PWM {i}: 0 = 8-bit, 1 = 12-bit", "1", read=mode, send=send_mode),
        _both(f"pwm{i}_width", part, "1", bits(word + 2, 0, 12)),
    ]


def _index_inputs() -> list[FrameField]:
    return [
        _both("encoder_index_active", "index input i is used", _BITMAP, bits(51, 0, 8)),
        _both("encoder_index_invert", "index input i is inverted", _BITMAP, bits(52, 0, 8)),
    ]


def _encoder(i: int) -> FrameField:
    meaning = f"encoder {i}: 32-bit quadrature counter (x4), wraps; the sign is read as two's complement"
    read = words(53 + 2 * i, 16, 16)
    return _field(f"encoder{i}_count", meaning, "counts", read=read, kind=ValueKind.SIGNED, status=Status.INFERRED)


def _encoders(count: int) -> list[FrameField]:
    reset = _both("encoder_reset", "counter i is held at 0 while bit i is 1", _BITMAP, bits(50, 0, count))
    return [reset, *map(_encoder, range(count))]


def _timers(count: int) -> list[FrameField]:
    meanings = (f"timer/counter {i}, wraps; a timer counts at 20 MHz" for i in range(count))
    return [
        _both("timer_reset", "timer/counter i is held at 0 while bit i is 1", _BITMAP, bits(70, 0, count)),
        _both("timer_mode", "timer/counter i: 0 = counter, 1 = timer", _BITMAP, bits(71, 0, count)),
        *(_field(f"timer{i}_value", what, "1", read=words(72 + 2 * i, 16, 16)) for i, what in enumerate(meanings)),
    ]


_METER_FLAGS: Final = (
    *("enable", "mode", "infinite", "software_start", "start_invert", "software_gate", "hardware_gate_select"),
    *("gate_invert", "gate_mode", "input_invert"),
)


def _frequency_meters() -> list[FrameField]:
    return [
        *(
            _both(f"frequency_meter_{flag}", f"{flag.replace('_', ' ')} of meter i", _BITMAP, bits(80 + k, 0, 8))
            for k, flag in enumerate(_METER_FLAGS)
        ),
        _field("frequency_meter_ready", "meter i has a result", _BITMAP, read=bits(106, 0, 8)),
        *(field for i in range(8) for field in _frequency_meter(i)),
    ]


def _frequency_meter(i: int) -> list[FrameField]:
    name, what = f"frequency_meter{i}", f"frequency meter {i}:"
    read, send = words(90 + 2 * i, 16, 16), words(90 + 2 * i, 15, 15)
    return [
        _field(f"{name}_timer", f"{what} gate time in clock ticks", "1", read=read, send=send),
        _field(f"{name}_counter", f"{what} running count", "1", read=words(107 + 2 * i, 16, 16)),
        _field(f"{name}_result", f"{what} last result", "1", read=words(123 + 2 * i, 16, 16)),
    ]


_TRIGGERS: Final = (
    "bit 0 enable, 1-2 trigger mode, 4 gate enable, 6 invert start/stop, 7 invert stop, 8 invert gate, 10 next, 11 arm"
)


def _chronometer(i: int) -> list[FrameField]:
    name, what = f"chronometer{i}", f"chronometer {i}:"
    read, send = words(148 + 2 * i, 16, 16), words(148 + 2 * i, 15, 15)
    return [
        _both(f"{name}_control", f"{what} {_TRIGGERS}", _BITMAP, bits(140 + i, 0, 12)),
        _field(f"{name}_status", f"{what} state", _RAW, read=bits(140 + i, 13, 3)),
        _field(f"{name}_divider", f"{what} clock divider", "1", read=read, send=send),
        _field(f"{name}_counter", f"{what} running count", "1", read=words(164 + 2 * i, 16, 16)),
        _field(f"{name}_result", f"{what} last result", "1", read=words(180 + 2 * i, 16, 16)),
    ]


def _analogue() -> list[FrameField]:
    gain, output = "gain code 0..4 = x1, x2, x4, x8, x16", "volts = -10 + 20 * code / 16383"
    gains = ((i, bits(200 + i // 4, 4 * (i % 4), 3)) for i in range(16))
    results = ((i, bits(204 + i, 0, 12), f"A/D {i}: volts = 10 * result / 2048 / gain") for i in range(16))
    return [
        *(_both(f"ad{i}_gain", f"A/D {i} {gain}", "1", place) for i, place in gains),
        *(_field(f"ad{i}_result", what, "1", read=place, kind=ValueKind.SIGNED) for i, place, what in results),
        *(_field(f"ad{i}_busy", f"A/D {i} is converting", "1", read=bits(204 + i, 12, 1)) for i in range(16)),
        *(_both(f"da{i}_output", f"D/A {i}: {output}", "1", bits(220 + i, 0, 14)) for i in range(4)),
    ]


def _thermal() -> FrameField:
    """Return the thermal flags; the same word is PWM 3's width in the generic logic."""
    meaning = "bit i: thermal protection of PWM i is on; every published program for such a logic sends 3"
    return _both("pwm_thermal_flags", meaning, _BITMAP, bits(31, 0, 2))


FIELDS: Final[tuple[FrameField, ...]] = (
    *_header(),
    *_digital(),
    *(field for i in range(PWM_CHANNELS) for field in _pwm(i)),
    *_encoders(ENCODER_CHANNELS),
    *_index_inputs(),
    *_timers(2),
    *_frequency_meters(),
    *(field for i in range(8) for field in _chronometer(i)),
    *_analogue(),
)
"""Fields of the generic logic."""


def _known_from(source: str, fields: Iterable[FrameField], status: Status | None = None) -> Iterator[FrameField]:
    """Yield the fields with their `source`, and with `status` except for the header, which is the same everywhere."""
    for field in fields:
        header = field.read is not None and field.read[0].word < HEADER_BYTES // 2
        yield replace(field, source=source, status=status if status and not header else field.status)


def _servo() -> tuple[FrameField, ...]:
    """Return the generic words with fewer channels: S5 names the channels, the words are inferred."""
    fields = [*_header(), *_digital(), *(field for i in range(4) for field in _pwm(i)), *_encoders(4), *_timers(2)]
    return tuple(_known_from("S1, S5", [*fields, *_analogue()], Status.INFERRED))


def _two_rotors() -> list[FrameField]:
    """Return the fields of TRAS, whose library writes no pin mode and no pin direction."""
    pwm = (field for i in range(2) for field in _pwm(i))
    return [*_header(), *_digital(mode=False), *pwm, _thermal(), *_encoders(2), *_timers(1), *_analogue()]


def _shared() -> list[FrameField]:
    """Return what servo, TRAS and rpend share, and the lever's encoder; the vendor's ABS rig on PCI has three encoders.

    The thermal flags are those of TRAS and rpend. In the servo's logic that word is the width of PWM 3, which drives
    nothing here, so that 3 does no harm there.
    """
    pwm = (field for i in range(2) for field in _pwm(i))
    return [*_header(), *_digital(), *pwm, _thermal(), *_encoders(3), *_timers(1)]


def _logic(name: str, fields: tuple[FrameField, ...]) -> Logic:
    of = "" if name == "generic" else f", {name} logic"
    read = FrameTable.of(fields, f"RT-DAC/USB2 READ frame{of}", size=FRAME_BYTES)
    send = FrameTable.of(fields, f"RT-DAC/USB2 SEND frame{of}", size=FRAME_BYTES, payload_bits=15, command=SEND_COMMAND)
    return Logic(name, fields, read, send, read, HEADER_BYTES, READ_REQUEST)


LOGICS: Final[Mapping[str, Logic]] = MappingProxyType(
    {
        name: _logic(name, fields)
        for name, fields in (
            ("generic", FIELDS),
            ("servo", _servo()),
            ("tras", tuple(_known_from("S4", _two_rotors()))),
            ("rpend", tuple(_known_from("S4, S10", _two_rotors(), Status.INFERRED))),
            ("abs", tuple(_known_from("S1, S4, S5, S10", _shared(), Status.INFERRED))),
        )
    }
)
"""By `frame_map` of a profile, as the versions of the rigs' logics are not published. `abs` has what servo, TRAS and
rpend share, all of it inferred."""

READ: Final = LOGICS["generic"].read
SEND: Final = LOGICS["generic"].send


def encode_send(values: Mapping[str, Value]) -> bytes:
    """Return the SEND frame of the generic logic with `values`; other fields are zero. Raises ProtocolError."""
    return SEND.encode(values)


def decode_read(frame: Buffer) -> dict[str, Value]:
    """Return all fields of a READ frame. Raises ProtocolError."""
    return READ.decode(frame)


def encode_read(values: Mapping[str, Value]) -> bytes:
    """Return the board's READ frame with `values`; other fields are zero. Raises ProtocolError."""
    return READ.encode(values)


def decode_send(frame: Buffer) -> dict[str, Value]:
    """Return all fields of a SEND frame. Raises ProtocolError."""
    return SEND.decode(frame)
