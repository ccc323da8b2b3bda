"""Parts of a protobuf FileDescriptorSet, built without generated code.

Field numbers and type numbers are those of `descriptor.proto` (protobuf.dev).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from inteco_abs.format.protobuf import chunk, integer

INT64: Final = 3
INT32: Final = 5
TEXT: Final = 9
MESSAGE: Final = 11
BYTES: Final = 12
ENUM: Final = 14
_OPTIONAL, _REPEATED = 1, 3


def field(name: str, number: int, kind: int, of: str = "", *, repeated: bool = False) -> bytes:
    """FieldDescriptorProto; `of` is the full name of the field's message or enum type."""
    label = _REPEATED if repeated else _OPTIONAL
    body = chunk(1, name) + integer(3, number) + integer(4, label) + integer(5, kind)
    return body + chunk(6, f".{of}") if of else body


def message(name: str, fields: Iterable[bytes]) -> bytes:
    """DescriptorProto with `fields`; nested types may be appended."""
    return chunk(1, name) + b"".join(chunk(2, body) for body in fields)


def enum(name: str, values: Iterable[tuple[str, int]]) -> bytes:
    """EnumDescriptorProto."""
    return chunk(1, name) + b"".join(chunk(2, chunk(1, value) + integer(2, number)) for value, number in values)


def proto_file(name: str, package: str, body: bytes) -> bytes:
    """FileDescriptorProto in proto3 syntax; `body` has its imports, messages and enums."""
    return chunk(1, name) + chunk(2, package) + body + chunk(12, "proto3")
