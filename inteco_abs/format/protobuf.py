"""The part of protobuf's wire format that a session needs, without generated code.

Source: protobuf.dev, "Encoding" and `descriptor.proto`. Tests decode everything with the official library.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

_FIXED: Final = {1: 8, 5: 4}
_LONGEST_VARINT: Final = 10


def varint(value: int) -> bytes:
    """Base-128 encoding of `value` >= 0."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def tag(number: int, wire_type: int) -> bytes:
    """Key in front of field `number`: wire type 0 varint, 1 64-bit, 2 length-delimited, 5 32-bit."""
    return varint(number << 3 | wire_type)


def integer(number: int, value: int) -> bytes:
    """Field `number` as a varint, for bool, enum and non-negative integers."""
    return tag(number, 0) + varint(value)


def double(number: int, value: float) -> bytes:
    """Field `number` as a double."""
    return tag(number, 1) + struct.pack("<d", value)


def chunk(number: int, data: bytes | str) -> bytes:
    """Field `number` as bytes, text or an encoded message."""
    raw = data.encode("utf-8") if isinstance(data, str) else data
    return tag(number, 2) + varint(len(raw)) + raw


def fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Number and value of each field of an encoded message; fixed-width values as bytes. Raises ValueError."""
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        number, wire_type = key >> 3, key & 7
        if wire_type == 0:
            value, at = _read_varint(data, at)
            yield number, value
            continue
        if wire_type == 2:
            length, at = _read_varint(data, at)
        elif wire_type in _FIXED:
            length = _FIXED[wire_type]
        else:
            raise ValueError(f"field {number} has the unknown wire type {wire_type}")
        if length > len(data) - at:
            raise ValueError(f"field {number} of {length} bytes leaves its message")
        yield number, data[at : at + length]
        at += length


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for place, byte in enumerate(data[at : at + _LONGEST_VARINT]):
        value |= (byte & 0x7F) << (7 * place)
        if byte < 0x80:
            return value, at + place + 1
    raise ValueError(f"the integer at byte {at} has no end")
