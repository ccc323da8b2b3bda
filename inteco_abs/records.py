"""Records of the constants and the state of a function, as arrays of numpy, which machine code reads and writes."""

from __future__ import annotations

from dataclasses import Field, fields, is_dataclass
from typing import Any, Final

import numpy as np

_LEAST_RING: Final = 128
"""Entries of a ring's array: with few lengths there are few types, each of which takes seconds to compile."""


def record(part: Any) -> Any:
    """The fields of a dataclass's instance as a record: numbers, flags, lists of numbers or of rows, and dataclasses.

    A list of numbers has an array with room for a power of two, at least _LEAST_RING.
    """
    return records(part)[0]


def records(*parts: Any) -> Any:
    """An array of such records, of instances of one dataclass whose lists are equally long."""
    return np.array([_values(part) for part in parts], _kind(parts[0])).view(np.recarray)


def restore(found: Any, part: Any) -> None:
    """Put what a record holds back into the dataclass's instance that it was made of, or one like it."""
    for field in fields(part):
        value, numbers = getattr(part, field.name), found[field.name]
        if is_dataclass(value):
            restore(numbers, value)
        elif isinstance(value, list):
            value[:] = numbers.tolist()[: len(value)]
        else:
            setattr(part, field.name, type(value)(numbers.item()))


def _kind(value: Any) -> np.dtype[Any]:
    if is_dataclass(value):
        return np.dtype([(field.name, _kind(getattr(value, field.name))) for field in row_fields(value)], align=True)
    if isinstance(value, list | tuple):
        return np.dtype((_kind(np.ravel(value)[0].item()), np.shape(_values(value))))
    return np.dtype(np.bool_ if isinstance(value, bool) else np.int64 if isinstance(value, int) else np.float64)


def _values(value: Any) -> Any:
    if is_dataclass(value):
        return tuple(_values(getattr(value, field.name)) for field in row_fields(value))
    if isinstance(value, list) and not isinstance(value[0], list):
        room = max(_LEAST_RING, 1 << (len(value) - 1).bit_length())
        return value + [value[0] * 0] * (room - len(value))
    return value


def row_fields(kind: Any) -> tuple[Field[Any], ...]:
    """Backwards: numba takes a record that begins as another one for that one, and warns; a subclass's would.

    So would those of two classes that end with the same fields: what many have comes first.
    """
    return fields(kind)[::-1]
