"""The little of protobuf's wire format that a session needs, without generated code.

Source: protobuf.dev, "Encoding" and `descriptor.proto`. Tests decode everything written here with the official
library.
"""

from __future__ import annotations

import struct


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
