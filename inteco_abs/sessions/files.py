"""Checks where a new file or folder may be made, and writes files atomically."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from inteco_abs.errors import ConfigError, SessionError, describe_disk

_PART: Final = ".part"
_BLOCK: Final = 1 << 20
_DEVICES: Final = re.compile("(?i)con|prn|aux|nul|conin[$]|conout[$]|(com|lpt)[0-9¹²³]")
_LETTERS: Final = frozenset('<>:"|?*')
"""Windows: names of devices, with any suffix; letters that no name of a file has."""
_WRONG_NAME: Final = (errno.EEXIST, errno.ENOTDIR, errno.ENAMETOOLONG, errno.EINVAL, errno.EILSEQ)
"""Errors that come from a folder's name, not from the disk."""


def check_output(path: Path, option: str = "--out") -> None:
    """Check that a new file can be made at `path`, given with `option`.

    Raises ConfigError, or SessionError if the folder cannot be written to.
    """
    problem = ""
    try:
        if sys.platform == "win32" and _kept_by_windows(path.name):
            problem = "Windows has no such file names; choose another"
        elif path.is_dir():
            problem = "is a folder; name a file in it"
        elif path.exists():
            problem = "exists already, and files are never overwritten; choose another name"
        elif not path.parent.is_dir():
            problem = f"the folder {path.parent} does not exist; create it first"
        str(path).encode()
    except UnicodeEncodeError:
        path, problem = Path(os.fsencode(path).decode(errors="backslashreplace")), "is not UTF-8; choose another name"
    except OSError as error:  # not a valid file name
        problem = describe_disk(error)
    if problem:
        raise ConfigError.of(option, f"{path}: {problem}")
    if not os.access(path.parent, os.W_OK):
        raise SessionError(f"{path} cannot be created: the folder {path.parent} cannot be written to; name another")


def _kept_by_windows(name: str) -> bool:
    """Whether it names a device, such as con.mcap, or has a letter that names of files do not have there."""
    device = _DEVICES.fullmatch(name.partition(".")[0].rstrip(" "))
    return device is not None or not _LETTERS.isdisjoint(name) or name.endswith((".", " "))


def check_session_file(out: Path) -> None:
    """Raise ConfigError for a path where no new session can be written, or where `list` would not find it."""
    check_output(out)
    if out.suffix != ".mcap":
        raise ConfigError.of("--out", f"{out}: must end in .mcap, by which sessions are found")


@contextmanager
def ensured_directory(folder: Path, option: str = "--out", *, new: bool = False) -> Iterator[None]:
    """Make `folder` and its parents if they are missing; remove those that are still empty at the end.

    Raises ConfigError for a path, given with `option`, that cannot be a folder, or that exists if it must be `new`;
    SessionError if the disk fails.
    """
    made = list[Path]()
    Path.cwd()  # raises if the current folder was removed
    try:
        try:
            made = [each for each in (folder, *folder.parents) if not each.exists()]
            folder.mkdir(parents=True, exist_ok=not new)
        except OSError as error:
            if error.errno not in _WRONG_NAME:
                raise SessionError(f"the folder {folder} cannot be made: {describe_disk(error)}") from error
            problem = "exists already; name a folder that does not exist" if folder.is_dir() else describe_disk(error)
            raise ConfigError.of(option, f"the folder {folder} cannot be made: {problem}") from error
        yield
    finally:
        for each in made:
            with suppress(OSError):  # it is not empty, or was never made
                each.rmdir()


def check_folder(folder: Path, option: str = "--out") -> None:
    """Check that `folder` can be made with its parents, or written to.

    Raises ConfigError, or SessionError without permission.
    """
    above = nearest_folder(folder)
    blocked = next((place for place in (folder, *folder.parents) if place.exists() and not place.is_dir()), None)
    if blocked is not None:
        raise ConfigError.of(option, f"{folder}: {blocked} is not a folder; choose another name")
    if not os.access(above, os.W_OK):
        raise SessionError(f"nothing can be made in {folder}: the folder {above} cannot be written to")


def nearest_folder(path: Path) -> Path:
    """The folder at `path`, or the nearest existing one above it."""
    path = path.absolute()
    return next(place for place in (path, *path.parents) if place.is_dir())


def require_own_file(path: Path, session_id: str) -> None:
    """Raise SessionError if the file at `path` is not empty and not part of the session with that id."""
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
    """A temporary path, renamed to `out` at the end; after an error, it is removed."""
    part = out.with_name(f"{out.name}.{secrets.token_hex(8)}{_PART}")  # other computers may write here, too
    try:
        yield part
    except BaseException:
        with suppress(OSError):  # missing, or the disk fails here too
            part.unlink()
        raise
    try:
        part.replace(out)
    except OSError as error:
        raise SessionError(f"{part} is complete but cannot be renamed to {out}: {error.strerror}") from error


def write_file(out: Path, data: bytes) -> None:
    """Write the new file `out` atomically. Raises ConfigError or SessionError."""
    check_output(out)
    with atomic_write(out) as part:
        try:
            part.write_bytes(data)
        except OSError as error:
            raise SessionError(f"{out} cannot be written: {describe_disk(error)}") from error


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
