"""Reads the layout of a flat message from the descriptor in a file, which may be of another version.

Numbers of fields and types are those of `descriptor.proto` (protobuf.dev).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from inteco_abs.format.descriptors import ENUM
from inteco_abs.format.protobuf import fields
from inteco_abs.format.schema import BOOL, DOUBLE, FIXED32, FIXED64, FLOAT, SFIXED64, Column, Message, MessageKind

_SFIXED32: Final = MessageKind(15, 5, "i", "<i4")
_ENUM: Final = MessageKind(ENUM, 0, "B", "u1")
_KINDS: Final = {kind.type_number: kind for kind in (DOUBLE, FLOAT, FIXED64, FIXED32, _SFIXED32, SFIXED64, BOOL, _ENUM)}
"""Types of fixed width; an enum has one byte if its values are below 128."""
_MOST_FIELDS: Final = 256
_HIGHEST_ENUM: Final = 0x7F
_REPEATED: Final = 3

_FILE, _PACKAGE, _MESSAGES, _FILE_ENUMS = 1, 2, 4, 5
_NAME, _FIELDS, _MESSAGE_ENUMS = 1, 2, 4
_NUMBER, _LABEL, _TYPE, _TYPE_NAME = 3, 4, 5, 6
_VALUES, _VALUE_NUMBER = 2, 2

Parts = Mapping[int, list[int | bytes]]
Members = Mapping[int, str]
"""Names by number, without the prefix of their enumeration."""


class DeclaredMessage(NamedTuple):
    """A message, and the members of each of its enumeration columns."""

    message: Message
    members: Mapping[str, Members]


def declared_message(descriptor: bytes, name: str, topic: str) -> DeclaredMessage:
    """The message `name` in a serialised FileDescriptorSet. Raises ValueError if it has no constant layout."""
    enums: dict[str, Members] = {}
    found: Parts | None = None
    for file in _messages(_parts(descriptor), _FILE):
        package = _text(file, _PACKAGE)
        for enum in _messages(file, _FILE_ENUMS):
            enums[f".{package}.{_text(enum, _NAME)}"] = _members(enum)
        for message in _messages(file, _MESSAGES):
            full = f"{package}.{_text(message, _NAME)}"
            if full == name:
                found = message
                for enum in _messages(message, _MESSAGE_ENUMS):
                    enums[f".{full}.{_text(enum, _NAME)}"] = _members(enum)
    if found is None:
        raise ValueError(f"it declares no message {name}")
    return _of_fields(name, topic, _messages(found, _FIELDS), enums)


def _of_fields(name: str, topic: str, found: list[Parts], enums: Mapping[str, Members]) -> DeclaredMessage:
    by_name = {_text(field, _NAME): field for field in found}
    if not 0 < len(found) <= _MOST_FIELDS or len(by_name) < len(found):
        raise ValueError(f"its {name} has {len(found)} fields: must be 1 to {_MOST_FIELDS} with different names")
    columns, members = [], {}
    numbered = sorted(by_name.items(), key=lambda each: _number(each[1], _NUMBER))
    for each, field in numbered:
        kind = _KINDS.get(_number(field, _TYPE))
        if kind is None or _number(field, _LABEL) == _REPEATED or not each.isidentifier():
            raise ValueError(f"its {name}.{each} has no constant width")
        columns.append(Column(each, kind, "", ""))
        if kind is _ENUM:
            members[each] = enums.get(_text(field, _TYPE_NAME), {})
    numbers = [_number(field, _NUMBER) for _, field in numbered]
    return DeclaredMessage(Message(name.rpartition(".")[2], topic, columns, numbers), members)


def _members(enum: Parts) -> Members:
    """Members of an enumeration; those that do not fit into a byte cannot occur in a constant layout."""
    prefix = f"{_text(enum, _NAME).upper()}_"
    values = {_number(value, _VALUE_NUMBER): _text(value, _NAME) for value in _messages(enum, _VALUES)}
    return {number: name.removeprefix(prefix) for number, name in values.items() if number <= _HIGHEST_ENUM}


def _parts(data: bytes) -> Parts:
    found: dict[int, list[int | bytes]] = {}
    for number, value in fields(data):
        found.setdefault(number, []).append(value)
    return found


def _messages(parts: Parts, number: int) -> list[Parts]:
    return [_parts(value) for value in parts.get(number, ()) if isinstance(value, bytes)]


def _text(parts: Parts, number: int) -> str:
    value = parts.get(number, [b""])[-1]
    if not isinstance(value, bytes):
        raise ValueError("a number was found instead of a name")  # noqa: TRY004  as every error of the descriptor
    return value.decode("utf-8")


def _number(parts: Parts, number: int) -> int:
    value = parts.get(number, [0])[-1]
    if not isinstance(value, int):
        raise ValueError("bytes were found instead of a number")  # noqa: TRY004  as every error of the descriptor
    return value
