"""Where a session file is: on this computer, or at an address of the web or of an object store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final

from inteco_abs.errors import AbsError, SessionError

_SCHEME: Final = "://"
_READ_AHEAD: Final = 1 << 18
"""Bytes of a request at least: what describes a session comes in one, and a chunk in two."""


def session_path(place: str | Path) -> Path:
    """The path of a session file; `place` may be an address such as "https://lab.example/stop.mcap" or "s3://lab/x.mcap".

    Raises AbsError without the extra `remote`, or without what the kind of address needs.
    """
    if isinstance(place, Path) or _SCHEME not in place:
        return Path(place)
    try:
        from upath import UPath  # noqa: PLC0415  an extra

        path: Any = UPath(place)  # it has the methods of a Path
    except (ImportError, ValueError) as error:  # ValueError: no such kind of address
        raise AbsError(f"{place}: cannot be read: {error}; pip install 'inteco-abs[remote]' reads http") from error
    found: Path = path
    return found


def is_local(path: object) -> bool:
    """Whether a path is one on this computer."""
    return isinstance(path, Path)


@contextmanager
def opened_for_reading(path: Path) -> Iterator[BinaryIO]:
    """The file at `path`. Raises OSError, and SessionError if what is at an address cannot be read in parts."""
    # how much one request reads matters at an address alone
    options: dict[str, Any] = {} if is_local(path) else {"block_size": _READ_AHEAD, "cache_type": "readahead"}
    try:
        with path.open("rb", **options) as file:
            yield file
    except _client_errors(path) as error:
        why = "its server gives no parts of a file; download it first" if isinstance(error, ValueError) else error
        raise SessionError(f"{path}: cannot be read: {why}") from error


def _client_errors(path: Path) -> tuple[type[Exception], ...]:
    """What reading at an address may raise beside OSError; ValueError if the server gives no parts of a file."""
    if is_local(path):
        return ()
    try:
        from aiohttp import ClientError  # noqa: PLC0415  of the extra `remote`
    except ImportError:
        return (ValueError,)
    return ClientError, ValueError
