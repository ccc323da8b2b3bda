"""Where a new file may be, and how it gets there: as a whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from inteco_abs.errors import ConfigError, Mistake, SessionError

_PART: Final = ".part"


def check_output(path: Path, option: str = "--out") -> None:
    """Refuse, before anything is opened, a path where no new file can be; `option` is where it was named.

    Raises ConfigError, or SessionError where the folder cannot be written to.
    """
    problem = ""
    try:
        if path.is_dir():
            problem = "is a folder; name a file in it"
        elif path.exists():
            problem = "exists already, and files are never overwritten; choose another name"
        elif not path.parent.is_dir():
            problem = f"the folder {path.parent} does not exist; create it first"
    except OSError as error:  # a name that no file can have
        problem = error.strerror or "cannot be a file's name"
    if problem:
        raise ConfigError([Mistake(option, f"{path}: {problem}")])
    if not os.access(path.parent, os.W_OK):
        raise SessionError(f"{path} cannot be created: the folder {path.parent} cannot be written to")


def check_folder(folder: Path, option: str = "--out") -> None:
    """Refuse a folder that cannot be made, parents and all, or not be written to; makes nothing.

    Raises ConfigError, or SessionError where the rights are missing.
    """
    above = nearest_folder(folder)
    blocked = next((place for place in (folder, *folder.parents) if place.exists() and not place.is_dir()), None)
    if blocked is not None:
        raise ConfigError([Mistake(option, f"{folder}: {blocked} is no folder; choose another name")])
    if not os.access(above, os.W_OK):
        raise SessionError(f"nothing can be made in {folder}: the folder {above} cannot be written to")


def nearest_folder(path: Path) -> Path:
    """The folder at `path`, or the nearest above it that exists already."""
    path = path.absolute()
    return next(place for place in (path, *path.parents) if place.is_dir())


def insist_on_own(path: Path, session_id: str) -> None:
    """Raise SessionError if at `path` there is anything but a beginning of the session with that id."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return
    except OSError as error:
        raise SessionError(f"{path} cannot be replaced: {error.strerror}") from error
    if data and session_id.encode() not in data:
        raise SessionError(f"{path} has become another file, and files are never overwritten")


@contextmanager
def only_whole(out: Path) -> Iterator[Path]:
    """Where to write what becomes `out` at the end. Its source still exists: of a failure nothing is left."""
    part = out.with_name(f"{out.name}.{os.getpid()}{_PART}")
    try:
        yield part
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    try:
        part.replace(out)
    except OSError as error:
        raise SessionError(f"{part} is complete but cannot be renamed to {out}: {error.strerror}") from error
