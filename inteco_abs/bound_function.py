"""A function with those that it gets as keywords, and the code that all of them are made of."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import astuple, is_dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final, NamedTuple

import numpy as np

import firmware_protocol
from inteco_abs import elementary

_OWN: Final = Path(elementary.__file__).parent, Path(firmware_protocol.__file__).parent


class BoundFunction(NamedTuple):
    """A function, and those that it gets as keywords."""

    function: Any
    keywords: tuple[tuple[str, BoundFunction], ...]

    @property
    def name(self) -> str:
        """Its qualified name, and theirs."""
        return "_".join([self.function.__qualname__, *(part.name for _, part in self.keywords)])

    def functions(self) -> set[BoundFunction]:
        """Itself, those that it gets, and all that these call."""
        found, waiting = {self}, [self]
        while waiting:
            part = waiting.pop()
            called: list[Any] = [value for value in part.globals() if isinstance(value, FunctionType)]
            if elementary in part.globals():
                called += elementary.ARITHMETICS[elementary.PORTABLE].values()
            new = {*map(bound, called), *dict(part.keywords).values()} - found
            found |= new
            waiting += new
        return found

    def globals(self) -> list[Any]:
        """What it uses of its module."""
        return [self.function.__globals__[name] for name in global_names(self.function)]

    def files(self) -> set[str]:
        """All files of this package or of a user that it comes from, with those of the functions that it calls."""
        return {part.function.__code__.co_filename for part in self.functions()}

    def content(self) -> str:
        """Digest of the code of all these functions, and of the constants that they use, which may be another file's.

        Not of their files: those may have changed since, or be missing.
        """
        return hashlib.sha256("\n".join(sorted(map(_text, self.functions()))).encode()).hexdigest()[:16]


def _text(part: BoundFunction) -> str:
    """What the machine code of a function depends on, but for that of others."""
    function = part.function
    codes = list(_codes(function.__code__))
    numbers = [repr(each) for code in codes for each in code.co_consts if not isinstance(each, CodeType)]
    texts = [(code.co_code, code.co_names, code.co_varnames) for code in codes]
    attributes = {name for code in codes for name in code.co_names}
    used = {name: _constant(function.__globals__[name], attributes) for name in global_names(function)}
    keywords = [(name, value.name) for name, value in part.keywords]
    return repr((function.__qualname__, texts, numbers, function.__defaults__, used, keywords))


def _codes(code: CodeType) -> Iterator[CodeType]:
    """That of a function, and of those that are defined in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _constant(value: Any, attributes: Iterable[str] = ()) -> Any:
    """A number, text, array or tuple, a dataclass's values, an enumeration's, or the fields of a tuple.

    Of a function its name, of a module those `attributes` that it has.
    """
    if isinstance(value, FunctionType):
        return value.__qualname__
    if isinstance(value, ModuleType):
        found = vars(value)
        return [(name, _constant(found[name])) for name in sorted(attributes) if name in found]
    if isinstance(value, type):
        return repr(list(value)) if issubclass(value, Enum) else repr(getattr(value, "_fields", ""))
    if isinstance(value, np.ndarray | np.generic):
        return repr(value.dtype), value.shape, value.tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        value = astuple(value)
    if isinstance(value, tuple | list):
        return [_constant(part) for part in value]
    return repr(value) if isinstance(value, int | float | str | bytes) else ""


def bound(function: Any) -> BoundFunction:
    """A function, or a partial of one whose keywords are such functions as well."""
    if isinstance(function, partial):
        keywords = tuple((name, bound(part)) for name, part in function.keywords.items())
        return BoundFunction(function.func, keywords)
    return BoundFunction(function, ())


def is_own(function: Any) -> bool:
    """Whether all source of `function` is this project's: tests ensure that its machine code has the bits of Python."""
    return all(any(Path(file).is_relative_to(folder) for folder in _OWN) for file in bound(function).files())


def global_names(function: Any) -> list[str]:
    """Names of the module that it uses."""
    used = (name for code in _codes(function.__code__) for name in code.co_names)
    return [name for name in dict.fromkeys(used) if name in function.__globals__]
