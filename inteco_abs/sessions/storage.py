"""Storage for the rows of a session while it is read: memory, or the disk for large sessions."""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import SessionError, describe_disk


class Rows(Protocol):
    """Messages of one constant layout, back to back."""

    def write(self, data: bytes, /) -> object:
        """Add rows. Raises SessionError if the disk is full."""

    def contents(self) -> bytes | memoryview:
        """All rows. Raises SessionError if the disk fails."""


class RowsInMemory:
    """Rows in memory: in an array, for which numpy asks for huge pages where it is large."""

    def __init__(self) -> None:
        self._room = np.empty(0, np.uint8)
        self._size = 0

    def write(self, data: bytes, /) -> None:
        first, self._size = self._size, self._size + len(data)
        if self._size > len(self._room):
            before, self._room = self._room, np.empty(2 * self._size, np.uint8)
            self._room[:first] = before[:first]
        self._room[first : self._size] = np.frombuffer(data, np.uint8)

    def contents(self) -> memoryview:
        return self._room[: self._size].data.toreadonly()


class ColumnsInMemory:
    """The `columns` in memory that rows of the layout `whole` have."""

    def __init__(self, whole: np.dtype[np.void], columns: Collection[str]) -> None:
        self._whole = whole
        self._kept = np.dtype([(name, whole[name]) for name in whole.names or () if name in columns])
        self._parts: list[bytes] = []

    def write(self, data: bytes, /) -> None:
        rows = np.frombuffer(data, self._whole)
        kept = np.empty(len(rows), self._kept)
        for name in self._kept.names or ():
            kept[name] = rows[name]
        self._parts.append(kept.tobytes())

    def contents(self) -> bytes:
        return b"".join(self._parts)

    def array(self) -> npt.NDArray[np.void]:
        """The columns, a row for each row."""
        return np.frombuffer(self.contents(), self._kept)


class RowsOnDisk:
    """Rows in an unnamed file in `folder`, which is freed with the last reference to its contents."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            self._file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115  closed on exit
        except OSError as error:
            raise self._no_room(error) from error

    def write(self, data: bytes, /) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise self._no_room(error) from error

    def contents(self) -> bytes | memoryview:
        try:
            size = os.fstat(self._file.fileno()).st_size
            return memoryview(mmap.mmap(self._file.fileno(), size, access=mmap.ACCESS_READ)) if size else b""
        except OSError as error:
            raise self._no_room(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        with suppress(OSError):  # its content is not needed any more
            self._file.close()

    def _no_room(self, error: OSError) -> SessionError:
        return SessionError(f"{self._folder}: has no room for the unpacked session: {describe_disk(error)}")
