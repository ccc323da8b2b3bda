"""Modules of Python that only POSIX systems have, and what to say where they are missing.

No other module imports them, so that every module can be imported on Windows. There, a missing module's name stands for
one whose every use raises BoardError.
"""

from __future__ import annotations

import select
import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.errors import BoardError

__all__ = [
    "PIPE_BUF",
    "TerminalError",
    "fcntl",
    "grp",
    "needs_linux",
    "require_linux",
    "require_posix",
    "resource",
    "termios",
    "tty",
]

PIPE_BUF: Final[int] = getattr(select, "PIPE_BUF", 512)
"""Largest message in bytes that a pipe takes whole; 512 is the least that POSIX allows."""


def needs_linux(what: str, instead: str = "") -> str:
    """A sentence: `what` needs Linux, this is another system, and what to do `instead`."""
    return f"{what} needs Linux, and this is {sys.platform}{instead and f'; {instead}'}"


def require_linux(what: str, instead: str = "") -> None:
    """Raise BoardError on every other system, with what to do `instead`."""
    if not sys.platform.startswith("linux"):
        raise BoardError(needs_linux(what, instead))


def require_posix(what: str, instead: str = "") -> None:
    """Raise BoardError on Windows, with what to do `instead`."""
    if sys.platform == "win32":
        raise BoardError(needs_linux(what, instead))


class _Missing(ModuleType):
    """Stands for a module that this system does not have."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # the import system and inspect look for these
            raise AttributeError(name)
        raise BoardError(needs_linux(f"{self.__name__}.{name}"))


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        return _Missing(name)


if TYPE_CHECKING:
    import fcntl
    import grp
    import resource
    import termios
    import tty
    from termios import error as TerminalError  # noqa: N812  as a class
else:
    fcntl, grp, resource, termios, tty = map(_module, ("fcntl", "grp", "resource", "termios", "tty"))
    TerminalError = OSError if isinstance(termios, _Missing) else termios.error
