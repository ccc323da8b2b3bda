"""Raw frames between host and board as messages, recorded on request for work on the protocol."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, NamedTuple

from inteco_abs.format.descriptors import BYTES, ENUM, TEXT, enum, field, message, proto_file
from inteco_abs.format.protobuf import chunk, fields, integer, tag
from inteco_abs.format.schema import FIXED64, PACKAGE

IO_TOPIC: Final = "/rig/io"
IO_NAME: Final = f"{PACKAGE}.IoFrame"
_TIME: Final = struct.Struct("<Q")
_TIME_KEY: Final = tag(1, FIXED64.wire_type)


class Direction(IntEnum):
    """Direction of a frame, or another event."""

    UNKNOWN = 0
    OUT = 1
    """The host wrote."""
    IN = 2
    """The board answered."""
    ERROR = 3
    """Writing failed, or no answer came."""
    WARNING = 4
    """A warning about the recording."""


class IoFrame(NamedTuple):
    """One frame between host and board, or a failed one. Fields are numbered from 1 in this order."""

    time_ns: int
    """Monotonic clock, as in the ticks."""
    direction: Direction
    data: bytes = b""
    text: str = ""
    """Text of an error or a warning."""
    of: str = ""
    """What failed: "out", "in" or "exchange"; empty without an error."""


def io_frame_descriptor() -> bytes:
    """Schema of `/rig/io`."""
    kinds = zip(IoFrame._fields, (FIXED64.type_number, ENUM, BYTES, TEXT, TEXT), strict=True)
    declared = [
        field(name, number, kind, f"{IO_NAME}.Direction" if kind == ENUM else "")
        for number, (name, kind) in enumerate(kinds, 1)
    ]
    members = enum("Direction", [(f"DIRECTION_{member.name}", int(member)) for member in Direction])
    body = chunk(4, message("IoFrame", declared) + chunk(4, members))
    return chunk(1, proto_file(f"{IO_NAME}.proto", PACKAGE, body))


def pack_io_frame(frame: IoFrame) -> bytes:
    """The frame as a message."""
    data = _TIME_KEY + _TIME.pack(frame.time_ns) + integer(2, frame.direction) + chunk(3, frame.data)
    if frame.text:
        data += chunk(4, frame.text)
    return data + chunk(5, frame.of) if frame.of else data


def unpack_io_frame(data: bytes) -> IoFrame:
    """Decode a message; fields of a later version are ignored. Raises ValueError if it is not valid."""
    found = dict(fields(data))
    time_ns, direction = found.get(1, bytes(_TIME.size)), found.get(2, 0)
    parts = [found.get(number, b"") for number in (3, 4, 5)]
    if not isinstance(time_ns, bytes) or len(time_ns) != _TIME.size or not isinstance(direction, int):
        raise ValueError("its time or its direction is not valid")
    texts = [part for part in parts if isinstance(part, bytes)]
    if len(texts) < len(parts):
        raise ValueError("a number was found instead of bytes")
    raw, text, of = texts
    return IoFrame(_TIME.unpack(time_ns)[0], Direction(direction), raw, text.decode("utf-8"), of.decode("utf-8"))
