"""A function with those that it gets as keywords, and the source that all of them come from."""

from __future__ import annotations

import hashlib
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

    def files(self) -> set[str]:
        """All files of this package or of a user that it comes from, with those of the functions that it calls."""
        used = [self.function.__globals__[name] for name in global_names(self.function)]
        parts = [*(bound(value) for value in used if isinstance(value, FunctionType)), *dict(self.keywords).values()]
        own = {elementary.__file__} if any(value is elementary for value in used) else set[str]()
        return own.union({self.function.__code__.co_filename}, *(part.files() for part in parts))

    def content(self) -> str:
        """Digest of all these files; empty where one is missing: a user's source may come without its file."""
        files = [Path(file) for file in sorted(self.files())]
        if not all(file.is_file() for file in files):
            return ""
        return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


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
