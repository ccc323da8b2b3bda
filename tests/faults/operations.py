"""What a program asks of the operating system in some folders, counted, so that the k-th request can be refused.

The calls are taken over where Python hands them on: in `os`, `io`, `mmap` and `subprocess`, and for as long as the test
wants. What the product makes of a refusal is its own doing.
"""

import errno
import io
import mmap
import os
import subprocess
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import NamedTuple

import pytest

from inteco_abs.sessions import file_writer

ERRORS = {
    "open": (errno.EACCES, errno.EROFS, errno.ENOSPC, errno.EIO),
    "write": (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EROFS),
    "read": (errno.EIO,),
    "fsync": (errno.EIO, errno.ENOSPC),
    "replace": (errno.EACCES, errno.EROFS, errno.ENOSPC, errno.EIO),
    "stat": (errno.EIO, errno.EACCES),
    "unlink": (errno.EROFS, errno.EACCES, errno.EIO),
    "close": (errno.EIO, errno.ENOSPC),
    "allocate": (errno.ENOSPC, errno.EIO),
    "map": (errno.ENOMEM, errno.EACCES),
    "process": (errno.EAGAIN, errno.ENOMEM),
}
"""What each kind of request is refused with, one after the other."""
ELSEWHERE = ("/sys/", "/proc/cpuinfo")
"""Asked, too: what a session says of the computer."""


class Refusal(NamedTuple):
    """Which request is refused."""

    number: int
    """Number of the request among all."""
    lasts: str = "once"
    """Or `kind`: all later ones of its kind, too; or `all`: nothing is granted any more."""


@dataclass
class Requests:
    """What was asked for in `folder`, and what of it was refused."""

    folder: str
    refusal: Refusal | None = None
    kinds: list[str] = field(default_factory=list)
    """Kinds of all requests, in order."""
    refused: int = 0
    """How many were."""
    aside: bool = False
    """Whether what is asked for now is the test's own doing."""

    @property
    def times(self) -> Counter[str]:
        return Counter(self.kinds)

    @property
    def refused_kind(self) -> str:
        """Kind of the first refused request; empty if none was refused."""
        return self.kinds[self.refusal.number] if self.refusal and self.refused else ""

    def ask(self, kind: str) -> None:
        """One more; raises OSError if it is refused."""
        if self.aside:
            return
        number = len(self.kinds)
        self.kinds.append(kind)
        if self.refusal is None or number < self.refusal.number:
            return
        first, lasts = self.refusal
        if number == first or lasts == "all" or (lasts == "kind" and kind == self.kinds[first]):
            self.refused += 1
            code = ERRORS[kind][first % len(ERRORS[kind])]
            raise OSError(code, os.strerror(code))

    def concern(self, place: object) -> bool:
        """Whether a path, or what an open file is, lies where requests are counted."""
        if isinstance(place, int):
            try:
                place = Path(f"/proc/self/fd/{place}").readlink()
            except OSError:
                return False
        return os.fsdecode(place).startswith((self.folder, *ELSEWHERE))


def file_class(requests: Requests) -> type[FileIO]:
    """Files whose every call is a request."""

    class Asked(FileIO):
        def __init__(self, file, mode="r", closefd=True, opener=None):
            requests.ask("open")
            super().__init__(file, mode, closefd, opener)

        def write(self, data, /):
            requests.ask("write")
            return super().write(data)

        def readinto(self, buffer, /):
            requests.ask("read")
            return super().readinto(buffer)

        def read(self, size=-1, /):
            requests.ask("read")
            return super().read(size)

        def readall(self):
            requests.ask("read")
            return super().readall()

        def close(self):
            open_still = not self.closed
            super().close()  # Linux releases a file even if close() fails
            if open_still:
                requests.ask("close")

    return Asked


def opener(requests: Requests, asked: type[FileIO], ordinary):
    """Stands in for `io.open`."""

    def opened(file, mode="r", buffering=-1, encoding=None, errors=None, newline=None, closefd=True, opener=None):
        if not requests.concern(file):
            return ordinary(file, mode, buffering, encoding, errors, newline, closefd, opener)
        raw = asked(file, mode.replace("b", "").replace("t", ""), closefd, opener)
        if buffering == 0:
            return raw
        kinds = {(True, True): io.BufferedRandom, (True, False): io.BufferedReader, (False, True): io.BufferedWriter}
        buffered = kinds[raw.readable(), raw.writable()](raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding, errors, newline)

    return opened


def taking_over(requests: Requests, kind: str, ordinary):
    """Stands in for a call of `os` whose first argument is a path or a file descriptor."""

    def call(place, *arguments, **named):
        if requests.concern(place):
            requests.ask(kind)
        return ordinary(place, *arguments, **named)

    return call


def closing(requests: Requests, ordinary):
    def close(file):
        asked = requests.concern(file)
        ordinary(file)
        if asked:
            requests.ask("close")

    return close


def accessing(requests: Requests, ordinary):
    def access(place, *arguments, **named):
        try:
            requests.ask("stat")
        except OSError:
            return False  # it never raises
        return ordinary(place, *arguments, **named)

    return access


OF_OS = {
    "open": "open", "write": "write", "pwrite": "write", "pread": "read", "fsync": "fsync",
    "fdatasync": "fsync", "replace": "replace", "rename": "replace", "stat": "stat", "fstat": "stat",
    "unlink": "unlink", "posix_fallocate": "allocate", "mkdir": "open", "rmdir": "unlink",
}  # fmt: skip


@contextmanager
def asking(folder: Path, refusal: Refusal | None = None) -> Iterator[Requests]:
    """While inside, everything asked for in `folder`, and every process that is started, is a request."""
    requests = Requests(str(folder), refusal)
    asked, disk = file_class(requests), file_writer.Disk
    # its own calls go to its base class by `super`, between which and it the counting class stands now
    counted = type("CountedDisk", (disk, asked), {})
    started = subprocess.Popen._execute_child

    def start(*arguments, **named):
        requests.ask("process")
        return started(*arguments, **named)

    with pytest.MonkeyPatch.context() as patch:
        for name, kind in OF_OS.items():
            patch.setattr(os, name, taking_over(requests, kind, getattr(os, name)))
        patch.setattr(os, "close", closing(requests, os.close))
        patch.setattr(os, "access", accessing(requests, os.access))
        patch.setattr(io, "open", opener(requests, asked, io.open))
        patch.setattr(mmap, "mmap", taking_over(requests, "map", mmap.mmap))
        patch.setattr(file_writer, "Disk", counted)
        patch.setattr(subprocess.Popen, "_execute_child", start)
        yield requests
