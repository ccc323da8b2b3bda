"""A disk that loses at a power cut what was not flushed: ext4 on a loop device, whose blocks a FUSE server keeps here.

The kernel sends every write and every flush of the block device to the server, which notes them with their times. The
disk after a cut at any instant is made afterwards: with the writes before the last flush that had ended by then, and of
the later ones with none, or with any choice of their sectors. Needs root and /dev/fuse.

Source: Linux, include/uapi/linux/fuse.h.
"""

import ctypes
import errno
import os
import stat
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

FUSE = Path("/dev/fuse")
SIZE = 32 << 20
"""Bytes of the disk."""
SECTOR = 512
LARGEST_WRITE = 128 << 10
ROOT, DISK = 1, 2
"""Numbers of the folder and of its only file, `disk`."""
REQUEST, ANSWER = struct.Struct("<IIQQIIIHH"), struct.Struct("<IiQ")
PLACE = struct.Struct("<QQI")
"""Open file, offset and size of a read or write."""
WRITE_HEAD = 40
ATTRIBUTES = struct.Struct("<QQQQQQIIIIIIIIII")
VALID_S = 1 << 30
"""How long the kernel may believe an answer."""
FORGET, INTERRUPT, BATCH_FORGET = 2, 36, 42
"""Requests without an answer."""
BIG_WRITES, MAX_PAGES = 1 << 5, 1 << 22


class Request(NamedTuple):
    """A write or, without data, a flush of the disk."""

    at: int
    data: bytes
    ended_ns: int
    """When it was answered, monotonic."""


class VolatileDisk:
    """Serves the file `disk` in `folder`, at first with the content of `image`; a flush takes `flush_s`."""

    def __init__(self, folder: Path, image: Path) -> None:
        self.flush_s = 0.0
        self.requests: list[Request] = []
        self._first = image
        self._content = bytearray(image.read_bytes())
        self._fuse = os.open(FUSE, os.O_RDWR)
        options = f"fd={self._fuse},rootmode={stat.S_IFDIR:o},user_id=0,group_id=0".encode()
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mount(b"disk", os.fsencode(folder), b"fuse", 0, options):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        self._answers = {
            1: self._look_up, 3: self._attributes, 4: self._attributes, 14: self._open, 15: self._read,
            16: self._write, 17: self._file_system, 18: self._nothing, 20: self._flush, 25: self._nothing,
            26: self._introduce, 27: self._open, 29: self._nothing,
        }  # fmt: skip
        threading.Thread(target=self._serve, daemon=True).start()

    def after_a_cut(self, at_ns: int, image: Path, survives: Callable[[], bool]) -> None:
        """Make `image` the disk after a power cut; `survives` decides for each sector that was not flushed."""
        ended = [number for number, request in enumerate(self.requests) if request.ended_ns <= at_ns]
        flushed = max((number for number in ended if not self.requests[number].data), default=0)
        with image.open("wb") as file:
            file.write(self._first.read_bytes())
            for number in ended:
                at, data, _ = self.requests[number]
                for start in range(0, len(data), SECTOR if number > flushed else LARGEST_WRITE):
                    if number < flushed or survives():
                        file.seek(at + start)
                        file.write(data[start : start + (SECTOR if number > flushed else LARGEST_WRITE)])

    def _serve(self) -> None:
        with suppress(OSError):  # ENODEV: it was unmounted
            while True:
                request = os.read(self._fuse, LARGEST_WRITE + (1 << 16))
                _, opcode, number, node, *_ = REQUEST.unpack_from(request)
                if opcode not in {FORGET, INTERRUPT, BATCH_FORGET}:
                    answer = self._answers.get(opcode)
                    data = answer(node, request[REQUEST.size :]) if answer else None
                    error = -errno.ENOSYS if answer is None else -errno.ENOENT if data is None else 0
                    data = data or b""
                    os.write(self._fuse, ANSWER.pack(ANSWER.size + len(data), error, number) + data)
        os.close(self._fuse)

    def _introduce(self, _node: int, _body: bytes) -> bytes:
        flags, background = BIG_WRITES | MAX_PAGES, (12, 9)
        return struct.pack("<IIIIHHIIHH32x", 7, 31, 0, flags, *background, LARGEST_WRITE, 1, LARGEST_WRITE >> 12, 0)

    def _look_up(self, _node: int, name: bytes) -> bytes | None:
        return struct.pack("<QQQQII", DISK, 0, VALID_S, VALID_S, 0, 0) + attributes(DISK) if name == b"disk\0" else None

    def _attributes(self, node: int, _body: bytes) -> bytes:
        return struct.pack("<QII", VALID_S, 0, 0) + attributes(node)

    def _open(self, _node: int, _body: bytes) -> bytes:
        return bytes(16)

    def _read(self, _node: int, body: bytes) -> bytes:
        _, at, size = PLACE.unpack_from(body)
        return bytes(self._content[at : at + size])

    def _write(self, _node: int, body: bytes) -> bytes:
        _, at, size = PLACE.unpack_from(body)
        data = body[WRITE_HEAD : WRITE_HEAD + size]
        self._content[at : at + size] = data
        self.requests.append(Request(at, data, time.monotonic_ns()))
        return struct.pack("<II", size, 0)

    def _flush(self, _node: int, _body: bytes) -> bytes:
        time.sleep(self.flush_s)
        self.requests.append(Request(0, b"", time.monotonic_ns()))
        return b""

    def _file_system(self, _node: int, _body: bytes) -> bytes:
        return bytes(80)

    def _nothing(self, _node: int, _body: bytes) -> bytes:
        return b""


def attributes(node: int) -> bytes:
    mode, size = (stat.S_IFDIR | 0o755, 0) if node == ROOT else (stat.S_IFREG | 0o600, SIZE)
    return ATTRIBUTES.pack(node, size, size // SECTOR, 0, 0, 0, 0, 0, 0, mode, 1, 0, 0, 0, 4096, 0)


@contextmanager
def volatile_disk(folder: Path) -> Iterator[tuple[VolatileDisk, Path]]:
    """The disk, and where its ext4 is mounted; `folder` is empty."""
    served, mounted, image = folder / "served", folder / "mounted", folder / "first.img"
    served.mkdir()
    mounted.mkdir()
    with image.open("wb") as file:
        file.truncate(SIZE)
    command("mkfs.ext4", "-q", "-E", "nodiscard,lazy_itable_init=0,lazy_journal_init=0", image)
    disk = VolatileDisk(served, image)
    try:
        with loop_mounted(served / "disk", mounted):
            yield disk, mounted
    finally:
        command("umount", served)


@contextmanager
def loop_mounted(image: Path, folder: Path) -> Iterator[None]:
    """The file system in `image` at `folder`; the kernel repeats its journal, as after a cut."""
    command("mount", "-o", "loop", image, folder)
    try:
        yield
    finally:
        command("umount", folder)


def command(*words: object) -> None:
    subprocess.run([*map(str, words)], check=True, timeout=60)
