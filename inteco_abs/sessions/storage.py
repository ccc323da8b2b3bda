"""Storage on the disk for the rows of a session while it is recovered."""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Self

from inteco_abs.errors import SessionError, describe_disk


class RowsOnDisk:
    """Rows in an unnamed file in `folder`, which is freed with the last reference to its contents."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115  closed on exit
        except OSError as error:
            raise self._no_room(error) from error

    def write(self, data: bytes, /) -> None:
        """Add rows. Raises SessionError if the disk is full, as all methods do if it fails."""
        rest = memoryview(data)
        try:
            self._file.seek(0, os.SEEK_END)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise self._no_room(error) from error

    def contents(self) -> bytes | memoryview:
        """All rows."""
        try:
            size = os.fstat(self._file.fileno()).st_size
            return memoryview(mmap.mmap(self._file.fileno(), size, access=mmap.ACCESS_READ)) if size else b""
        except OSError as error:
            raise self._no_room(error) from error

    def blocks(self, size: int) -> Iterator[bytes]:
        """All rows in blocks of `size` bytes, the last one shorter."""
        at = 0
        try:
            while self._file.seek(at) == at and (block := self._file.read(size)):
                yield block
                at += len(block)
        except OSError as error:
            raise self._no_room(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        with suppress(OSError):  # its content is not needed any more
            self._file.close()

    def _no_room(self, error: OSError) -> SessionError:
        return SessionError(f"{self._folder}: has no room for the unpacked session: {describe_disk(error)}")
