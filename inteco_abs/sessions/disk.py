"""The file of a session on a disk: errors as SessionError, and a thread that syncs it, so that writing never waits."""

from __future__ import annotations

import errno
import os
import sys
import time
from contextlib import suppress
from io import FileIO
from pathlib import Path
from threading import Condition, Thread
from typing import TYPE_CHECKING, Final

from inteco_abs.errors import SessionError, describe_disk

if TYPE_CHECKING:
    from typing_extensions import Buffer  # collections.abc has it from Python 3.12 on

_SLOW_NS: Final = 1_000_000_000


class Disk(FileIO):
    """A new file that raises SessionError instead of OSError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._syncing: _Syncing | None = None
        try:
            super().__init__(path, "xb+")
        except OSError as error:
            raise SessionError(f"{path} cannot be created: {describe_disk(error)}") from error

    def write(self, data: Buffer, /) -> int:
        """Write some of `data`."""
        try:
            return super().write(data)
        except OSError as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """Close the file; do not wait for a sync. Raises SessionError if its last bytes cannot be written."""
        if self._syncing is not None:
            self._syncing.close()
            self._syncing = None
        try:
            super().close()
        except OSError as error:
            raise self._failed(error) from error

    def sync(self, mark: int, *, wait: bool) -> None:
        """Let the content so far reach the disk; `synced` is then `mark`.

        Without `wait`, return at once: a slow sync is followed by one for all that came meanwhile. Raises SessionError
        if this sync or an earlier one failed.
        """
        try:
            if self._syncing is None:
                self._syncing = _Syncing(self.path, self.fileno())
            self._syncing.ask(mark, wait=wait)
        except OSError as error:
            raise self._failed(error) from error

    @property
    def synced(self) -> int:
        """Mark of the newest content that is known to be on the disk."""
        return 0 if self._syncing is None else self._syncing.synced

    def slow_syncs(self) -> list[tuple[int, int]]:
        """Beginning (monotonic clock) and duration, ns, of the syncs since the last call that took over a second."""
        return [] if self._syncing is None else self._syncing.slow_syncs()

    def require_linked(self) -> None:
        """Raise SessionError if the file was removed or replaced: writing to it succeeds, but is lost."""
        try:
            found, ours = self.path.stat(), os.fstat(self.fileno())
        except OSError as error:
            raise SessionError(f"{self.name} is gone: {error.strerror}") from error
        if not os.path.samestat(found, ours):
            raise SessionError(f"{self.name} is gone: another file has its name")

    def _failed(self, error: OSError) -> SessionError:
        return SessionError(f"{self.name} cannot be written: {describe_disk(error)}")


class _Syncing:
    """A thread that syncs a file and, once, the folder that holds its name.

    It has a file descriptor of its own: whoever closes the file does not wait for a disk that hangs. Errors are raised
    by the next call, as Linux reports each only once.
    """

    def __init__(self, path: Path, file: int) -> None:
        self._path = path
        self._file = os.dup(file)
        self._change = Condition()
        self._asked = self._done = 0
        """Number of requests, and of those that are fulfilled."""
        self._mark = self.synced = 0
        self._slow: list[tuple[int, int]] = []
        self._error: OSError | None = None
        self._closed = False
        self._thread = Thread(target=self._run, name="sync", daemon=True)
        self._thread.start()

    def ask(self, mark: int, *, wait: bool) -> None:
        """Ask for a sync. Raises OSError."""
        with self._change:
            self._asked, self._mark = self._asked + 1, mark
            wanted = self._asked
            self._change.notify_all()
            if wait:
                self._change.wait_for(lambda: self._done >= wanted or self._error or self._closed)
            if self._error is not None:
                raise self._error
            if wait and self._done < wanted:
                raise OSError(errno.EBADF, "closed before its content was on the disk")

    def slow_syncs(self) -> list[tuple[int, int]]:
        with self._change:
            found, self._slow = self._slow, []
            return found

    def close(self) -> None:
        """End the thread; wait for it unless it waits for the disk, on Windows always."""
        with self._change:
            self._closed = True
            idle = self._done == self._asked
            self._change.notify_all()
        if idle or sys.platform == "win32":  # which renames no file that is open
            self._thread.join()

    def _run(self) -> None:
        try:
            while self._next():
                pass
        except OSError as error:
            with self._change:
                self._error = error
                self._change.notify_all()
        finally:
            with self._change:  # so that no one waits for a thread that is gone
                self._closed = True
                self._change.notify_all()
            with suppress(OSError):
                os.close(self._file)

    def _next(self) -> bool:
        """Fulfil the requests so far; False when closed."""
        with self._change:
            self._change.wait_for(lambda: self._closed or self._asked > self._done)
            if self._closed:
                return False
            asked, mark = self._asked, self._mark
        began_ns = time.monotonic_ns()
        getattr(os, "fdatasync", os.fsync)(self._file)
        if not self._done:
            _sync_folder(self._path.parent)
        took_ns = time.monotonic_ns() - began_ns
        with self._change:
            self._done, self.synced = asked, mark
            if took_ns > _SLOW_NS:
                self._slow.append((began_ns, took_ns))
            self._change.notify_all()
        return True


def _sync_folder(folder: Path) -> None:
    """Let the names in `folder` reach the disk, where the system can do that. Raises OSError."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno not in {errno.EINVAL, errno.ENOTSUP}:  # some network file systems
            raise
    finally:
        os.close(file)
