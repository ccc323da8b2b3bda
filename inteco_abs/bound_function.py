"""A function with those that it gets as keywords, and the source that all of them come from."""

from __future__ import annotations

import hashlib
from dataclasses import is_dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from types import FunctionType
from typing import Any, Final, NamedTuple

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
            called = [bound(value) for value in part.globals() if isinstance(value, FunctionType)]
            new = {*called, *dict(part.keywords).values()} - found
            found |= new
            waiting += new
        return found

    def globals(self) -> list[Any]:
        """What it uses of its module."""
        return [self.function.__globals__[name] for name in global_names(self.function)]

    def files(self) -> set[str]:
        """All files of this package or of a user that it comes from, with those of the functions that it calls."""
        functions = self.functions()
        own = {elementary.__file__} if any(elementary in part.globals() for part in functions) else set[str]()
        return own | {part.function.__code__.co_filename for part in functions}

    def content(self) -> str:
        """Digest of all these files, and of constants, which may be another file's.

        Empty where a file is missing: a user's source may come without its own.
        """
        files = [Path(file) for file in sorted(self.files())]
        if not all(file.is_file() for file in files):
            return ""
        constants = {_constant(value) for part in self.functions() for value in part.globals()}
        text = b"".join(file.read_bytes() for file in files) + "\n".join(sorted(constants)).encode()
        return hashlib.sha256(text).hexdigest()[:16]


def _constant(value: Any) -> str:
    """A number, text or tuple, a dataclass's values, an enumeration's, or the fields of a tuple, as text."""
    if isinstance(value, type):
        return repr(list(value)) if issubclass(value, Enum) else repr(getattr(value, "_fields", ""))
    return repr(value) if isinstance(value, int | float | str | tuple) or is_dataclass(value) else ""


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
    return [name for name in function.__code__.co_names if name in function.__globals__]
