"""Where a new file may be, and how it gets there: as a whole or not at all."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from inteco_abs.errors import ConfigError, SessionError, describe_disk

_PART: Final = ".part"
_BLOCK: Final = 1 << 20
_NO_PLACE: Final = (errno.EEXIST, errno.ENOTDIR, errno.ENAMETOOLONG, errno.EINVAL, errno.EILSEQ)
"""What is wrong with a folder's name, not with the disk."""


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
        problem = describe_disk(error)
    if problem:
        raise ConfigError.of(option, f"{path}: {problem}")
    if not os.access(path.parent, os.W_OK):
        raise SessionError(f"{path} cannot be created: the folder {path.parent} cannot be written to; name another")


@contextmanager
def ensured_directory(folder: Path, option: str = "--out", *, new: bool = False) -> Iterator[None]:
    """With `folder`, made with its parents where there is none; of what was made, what is empty at the end goes again.

    Raises ConfigError for a path where no folder can be, or of an old one where a `new` one is wanted, and
    SessionError where the disk refuses; `option` is where it was named.
    """
    made = list[Path]()
    Path.cwd()  # raises where the folder in which this was typed is gone
    try:
        try:
            made = [each for each in (folder, *folder.parents) if not each.exists()]
            folder.mkdir(parents=True, exist_ok=not new)
        except OSError as error:
            if error.errno not in _NO_PLACE:
                raise SessionError(f"the folder {folder} cannot be made: {describe_disk(error)}") from error
            problem = "exists already; name a folder that does not exist" if folder.is_dir() else describe_disk(error)
            raise ConfigError.of(option, f"the folder {folder} cannot be made: {problem}") from error
        yield
    finally:
        for each in made:
            with suppress(OSError):  # it is not empty, or was never made
                each.rmdir()


def check_folder(folder: Path, option: str = "--out") -> None:
    """Refuse a folder that cannot be made, parents and all, or not be written to; makes nothing.

    Raises ConfigError, or SessionError where the rights are missing.
    """
    above = nearest_folder(folder)
    blocked = next((place for place in (folder, *folder.parents) if place.exists() and not place.is_dir()), None)
    if blocked is not None:
        raise ConfigError.of(option, f"{folder}: {blocked} is not a folder; choose another name")
    if not os.access(above, os.W_OK):
        raise SessionError(f"nothing can be made in {folder}: the folder {above} cannot be written to")


def nearest_folder(path: Path) -> Path:
    """The folder at `path`, or the nearest above it that exists already."""
    path = path.absolute()
    return next(place for place in (path, *path.parents) if place.is_dir())


def require_own_file(path: Path, session_id: str) -> None:
    """Raise SessionError if at `path` there is anything but a beginning of the session with that id."""
    wanted, data = session_id.encode(), b""
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                data = data[-len(wanted) :] + block
                if wanted in data:
                    return
    except FileNotFoundError:
        return
    except OSError as error:
        raise SessionError(f"{path} cannot be replaced: {error.strerror}") from error
    if data:
        raise SessionError(f"{path} has become another file, and files are never overwritten")


@contextmanager
def atomic_write(out: Path) -> Iterator[Path]:
    """Where to write what becomes `out` at the end. Its source still exists: of a failure nothing is left."""
    part = out.with_name(f"{out.name}.{os.getpid()}{_PART}")
    try:
        yield part
    except BaseException:
        with suppress(OSError):  # it is not there, or cannot be removed either
            part.unlink()
        raise
    try:
        part.replace(out)
    except OSError as error:
        raise SessionError(f"{part} is complete but cannot be renamed to {out}: {error.strerror}") from error
