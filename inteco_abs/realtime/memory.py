"""What the processes of one run share: words, notes, two rings. One file in memory, which outlives any of them.

Nobody takes a lock. Every word has one writer at a time; readers poll.
"""

from __future__ import annotations

import errno
import json
import mmap
import os
import select
import shutil
import stat
import struct
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from enum import IntEnum, auto
from pathlib import Path
from typing import Any, Final, Self

from inteco_abs.errors import SessionError
from inteco_abs.realtime.histogram import Histogram
from inteco_abs.realtime.ring import Pack, RingReader, TickRing, ring_bytes

FOLDER: Final = Path("/dev/shm")  # noqa: S108  memory, not a place for temporary files; the name is unique
SUFFIX: Final = ".ring"
_PREFIX: Final = "inteco-abs-"
_SOCKET: Final = ".board"
_FRAMES: Final = ".frames"
_KIND: Final = b"inteco-abs ring"
_MAGIC: Final = _KIND + b" 2\n"
_HEADER: Final = struct.Struct("<32s4Q")
_POLL_S: Final = 0.001
_NO_PROCESS: Final = (errno.ESRCH, errno.EINVAL, errno.ENOENT)
"""Of pidfd_open: there is none, or the number is that of a mere thread (ENOENT since Linux 6.9)."""
_LARGEST_PID: Final = (1 << 31) - 1
_START_TIME: Final = 19
"""Field of /proc/PID/stat, counted from 0 behind the name (proc(5): field 22)."""


class Field(IntEnum):
    """Eight-byte words, by their writer.

    The drill comes before the loop, and the supervisor after a guardian that is gone: one takes the other's place.
    """

    # the supervisor
    SUPERVISOR_PID = 0
    SUPERVISOR_BEAT_NS = auto()
    GUARDED_PID = auto()
    """Process that the guardian is to watch."""
    LOOP_PID = auto()
    RECORDER_PID = auto()
    STOP = auto()
    """Reason for which the operator's side wants the run to end."""
    GO = auto()
    """Everything is ready: the loop may begin."""
    OVER = auto()
    """Nothing is left to guard."""
    # the process that holds the board: first the one of the drill, then the loop
    HOLDER_PID = auto()
    """Set before the board is opened, 0 again once SAFE has been read back."""
    READY = auto()
    """Pid of the holder once its board is open and safe."""
    # the guardian
    GUARDIAN_BEAT_NS = auto()
    GUARDING_PID = auto()
    """What the guardian watches by now."""
    GUARDIAN_STOP = auto()
    """Reason for which the guardian wants the run to end."""
    RESCUED_PID = auto()
    """Whose board the guardian has taken over last and made safe, or tried to: see the note RESCUE."""
    SAVING = auto()
    """1 while the loop's process, its board let go of, writes what was recorded of the wire."""
    # the recorder
    RECORDER_BEAT_NS = auto()
    RECORDING = auto()
    """1 once everything that explains the run is on the disk."""
    FLUSHED = auto()
    """Ticks that are in the file for sure."""
    LIVE_PORT = auto()
    """Where the run is served to viewers; 0 if it is not."""
    TROUBLES = auto()
    """How often a disk has refused: see the note TROUBLES."""
    # the supervisor again
    KEPT = auto()
    """1 once it has said that the ticks stay here."""
    EPOCH_NS = auto()
    """UNIX time of the monotonic clock's zero."""
    UNRECORDED = auto()
    """1 if its ticks are for a screen only, and to be kept by nobody."""
    # the panel's screen
    REQUESTED_DRIVE = auto()
    """Duty, in millionths."""
    REQUESTED_BRAKE = auto()
    KEY_SEEN_NS = auto()
    """When the key that keeps the outputs on was last seen."""
    LOOKS_ASKED = auto()
    """Readings of the whole board that it has asked for."""
    # the process that holds the board for it
    LOOKS = auto()
    """Which of them is in the note RESULT."""
    # whoever comes first
    ALARMED = auto()
    """1 once the user has been told that nobody drives a board that is held."""
    # when the processes that a run belongs to have started: a number may be given to another process later
    SUPERVISOR_STARTED = auto()
    """Ticks of the system's clock since it was started, as in `start_time`; 0 if not known."""
    LOOP_STARTED = auto()
    RECORDER_STARTED = auto()


class Mailbox(IntEnum):
    """Texts and images that one process leaves for the others."""

    JOB = 0
    INTRODUCTION = auto()
    SAFE_IMAGE = auto()
    DRILL = auto()
    """What the guardian's drill showed."""
    CONCLUSION = auto()
    FAILURE = auto()
    """Of the loop: why it ended before or after the run."""
    RECORDER_FAILURE = auto()
    RESCUE = auto()
    RESULT = auto()
    SURROUNDINGS = auto()
    """Packages and changes of the source tree, which take the recorder too long to be gathered twice."""
    INJECTED = auto()
    """How often each fault of the mock board has acted."""
    TROUBLES = auto()
    """What the recorder has to say of its disks, and which file it writes by now."""


_NOTE_BYTES: Final = {Mailbox.JOB: 2 << 20, Mailbox.SURROUNDINGS: 2 << 20}
_OTHER_NOTE_BYTES: Final = 64 << 10
_WORDS_AT: Final = 4096
_NOTES_AT: Final = 8192
_OWNERS: Final = {
    Field.SUPERVISOR_PID: Field.SUPERVISOR_STARTED,
    Field.LOOP_PID: Field.LOOP_STARTED,
    Field.RECORDER_PID: Field.RECORDER_STARTED,
}
"""Processes that a run belongs to: number, and start."""


def _note_places() -> tuple[dict[Mailbox, tuple[int, int]], int]:
    places, at = {}, _NOTES_AT
    for note in Mailbox:
        size = _NOTE_BYTES.get(note, _OTHER_NOTE_BYTES)
        places[note] = at, size
        at += size
    return places, at


_NOTES, _HISTOGRAM_AT = _note_places()
_RINGS_AT: Final = -(-(_HISTOGRAM_AT + Histogram.BYTES) // 4096) * 4096


def run_bytes(tick_bytes: int, tick_capacity: int, truth_bytes: int, truth_capacity: int) -> int:
    """Size of the memory of a run with so many records of such sizes."""
    return _RINGS_AT + ring_bytes(tick_bytes, tick_capacity) + ring_bytes(truth_bytes, truth_capacity)


def require_room(size: int) -> None:
    """Raise SessionError unless the system has so many bytes of shared memory now; takes none of it."""
    try:
        free = shutil.disk_usage(FOLDER).free
    except OSError as error:
        raise _no_room(size, error.strerror or str(error)) from error
    if free < size:
        raise _no_room(size, f"{free / 1e6:.0f} MB are free")


def _no_room(size: int, why: str) -> SessionError:
    return SessionError(
        f"the run needs {size / 1e6:.0f} MB of shared memory in {FOLDER}: {why}; free some, or set loop.ring_s to less"
    )


class RunMemory:
    """Shared memory of one run; `create` it once, `open` it in every other process."""

    def __init__(self, path: Path, mapping: mmap.mmap) -> None:
        self.path = path
        self._kept = False
        self._mapping = mapping
        self._memory = memoryview(mapping)
        self.words = self._memory[_WORDS_AT:_NOTES_AT].cast("q")
        _, self._tick_bytes, self.tick_capacity, self._truth_bytes, self._truth_capacity = _HEADER.unpack_from(mapping)
        ticks = ring_bytes(self._tick_bytes, self.tick_capacity)
        truths = ring_bytes(self._truth_bytes, self._truth_capacity)
        self._ticks = self._memory[_RINGS_AT : _RINGS_AT + ticks]
        self._truths = self._memory[_RINGS_AT + ticks : _RINGS_AT + ticks + truths]
        self.histogram = Histogram(self._memory[_HISTOGRAM_AT : _HISTOGRAM_AT + Histogram.BYTES])

    @classmethod
    def create(cls, tick_bytes: int, tick_capacity: int, truth_bytes: int, truth_capacity: int) -> Self:
        """New memory for so many records of such sizes. Raises SessionError if there is not enough."""
        size = run_bytes(tick_bytes, tick_capacity, truth_bytes, truth_capacity)
        path = FOLDER / f"{_PREFIX}{uuid.uuid4()}{SUFFIX}"
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
            try:
                os.posix_fallocate(file, 0, size)  # now, rather than a bus error in mid-run
                os.pwrite(file, _HEADER.pack(_MAGIC, tick_bytes, tick_capacity, truth_bytes, truth_capacity), 0)
            finally:
                os.close(file)
            memory = cls.open(path)
        except OSError as error:
            _unlink(path)
            raise _no_room(size, error.strerror or str(error)) from error
        except BaseException:
            _unlink(path)
            raise
        memory.name(Field.SUPERVISOR_PID, os.getpid())
        memory.words[Field.EPOCH_NS] = time.time_ns() - time.monotonic_ns()
        return memory

    @classmethod
    def private(cls, tick_bytes: int, tick_capacity: int) -> Self:
        """Memory of this process alone, without a file: for a board that is held here, in virtual time."""
        mapping = mmap.mmap(-1, run_bytes(tick_bytes, tick_capacity, 1, 1))
        _HEADER.pack_into(mapping, 0, _MAGIC, tick_bytes, tick_capacity, 1, 1)
        return cls(Path(), mapping)

    @classmethod
    def open(cls, path: Path) -> Self:
        """Memory of a run that exists; raises SessionError if it is none, or cannot be had."""
        try:
            file = os.open(path, os.O_RDWR)
            try:
                size = os.fstat(file).st_size
                if size < _RINGS_AT or os.pread(file, len(_MAGIC), 0) != _MAGIC:
                    raise SessionError(f"{path}: is not a tick ring of this version")
                # every page now: the loop must not meet a page fault
                mapping = mmap.mmap(file, size, flags=mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
            finally:
                os.close(file)
        except OSError as error:
            raise SessionError(f"{path}: {error.strerror or error}") from error
        _, tick_bytes, ticks, truth_bytes, truths = _HEADER.unpack_from(mapping)
        if size != _RINGS_AT + ring_bytes(tick_bytes, ticks) + ring_bytes(truth_bytes, truths):
            raise SessionError(f"{path}: has {size} bytes, which is not what its header says: it was cut")
        return cls(path, mapping)

    def keep(self) -> None:
        """Make `remove` leave everything where it is: what it holds is nowhere else."""
        self._kept = True
        self.words[Field.KEPT] = 1
        _unlink(self.socket)

    def remove(self) -> None:
        """Give the memory back once everybody has left it; what it holds is in the file by now.

        A copy that lies elsewhere is the user's own, and stays.
        """
        if self._kept or FOLDER.resolve() not in self.path.resolve().parents:
            return
        _unlink_all(self.path)

    @property
    def socket(self) -> Path:
        """Where the mock board of this run listens, if it has one."""
        return self.path.with_suffix(_SOCKET)

    @property
    def frames(self) -> Path:
        """Where the loop's process leaves what passed between it and the board, if that was asked for."""
        return self.path.with_suffix(_FRAMES)

    def name(self, owner: Field, pid: int) -> None:
        """Process `pid` is now the run's `owner`: SUPERVISOR_PID, LOOP_PID or RECORDER_PID."""
        self.words[_OWNERS[owner]] = start_time(pid)
        self.words[owner] = pid

    def in_use(self) -> bool:
        """Whether any process of the run may still need it."""
        return _in_use(self.words)

    def post(self, note: Mailbox, content: Any) -> None:
        """Leave a note: bytes, or anything that JSON can say."""
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        at, size = _NOTES[note]
        if len(data) > size - 8:
            raise SessionError(f"{note.name.lower()} of {len(data)} bytes is too long: at most {size - 8}")
        struct.pack_into("<Q", self._memory, at, 0)
        self._memory[at + 8 : at + 8 + len(data)] = data
        struct.pack_into("<Q", self._memory, at, len(data) + 1)  # last: a note is there as a whole or not at all

    def image(self, note: Mailbox) -> bytes | None:
        """A note's bytes; None if it was not left yet, or is just being replaced."""
        at, _ = _NOTES[note]
        (length,) = struct.unpack_from("<Q", self._memory, at)
        data = bytes(self._memory[at + 8 : at + 7 + length]) if length else None
        return data if struct.unpack_from("<Q", self._memory, at) == (length,) else None

    def note(self, note: Mailbox) -> Any:
        """A note; None if it was not left yet."""
        data = self.image(note)
        return None if data is None else json.loads(data)

    def tick_ring(self, pack: Pack, first: int = 0) -> TickRing:
        """The loop's end of the ticks, whose first record has that number."""
        return TickRing(pack, self._tick_bytes, self.tick_capacity, self._ticks, first)

    def tick_reader(self) -> RingReader:
        """A reader's end of the ticks."""
        return RingReader(self._ticks, self._tick_bytes, self.tick_capacity)

    def truth_ring(self, pack: Pack, first: int = 0) -> TickRing:
        """The mock board's end of its own record, whose first record has that number."""
        return TickRing(pack, self._truth_bytes, self._truth_capacity, self._truths, first)

    def truth_reader(self) -> RingReader:
        """A reader's end of the mock board's record."""
        return RingReader(self._truths, self._truth_bytes, self._truth_capacity)

    def wait(self, condition: Callable[[], object], most_s: float) -> bool:
        """Poll until `condition()` is true; False after `most_s`."""
        end = time.monotonic() + most_s
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(_POLL_S)
        return True


def is_ring(path: Path) -> bool:
    """Whether a file is what a run leaves in memory, of whatever version."""
    try:
        if not path.is_file():  # to open a pipe is to wait for who writes into it
            return False
        with path.open("rb") as file:
            return file.read(len(_KIND)) == _KIND
    except OSError:
        return False


def left_rings(folder: Path = FOLDER) -> Iterator[Path]:
    """Memories of this user's runs whose every process is gone before their file was complete.

    Those without a tick, or with none to be kept, are removed. Looks at a few words of each, as a memory may be large.
    """
    for path in sorted(folder.glob(f"{_PREFIX}*{SUFFIX}")):
        head = _head_of_own(path)
        if len(head) < _RINGS_AT + 8 or not head.startswith(_MAGIC):
            continue
        words = memoryview(head)[_WORDS_AT:_NOTES_AT].cast("q")
        if not words[Field.SUPERVISOR_PID] or _in_use(words):
            continue  # just being made, or in use
        if struct.unpack_from("<Q", head, _RINGS_AT)[0] and not words[Field.UNRECORDED]:
            yield path
        else:
            _unlink_all(path)


def _head_of_own(path: Path) -> bytes:
    """Beginning of a regular file of this user's; empty for anything else: all users may put pipes and links there."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
        try:
            found = os.fstat(file)
            own = stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid()
            return os.pread(file, _RINGS_AT + 8, 0) if own else b""
        finally:
            os.close(file)
    except OSError:
        return b""  # gone meanwhile


def _in_use(words: memoryview) -> bool:
    """Whether any process that the run belongs to has not ended; a kept memory needs none of them."""
    return not words[Field.KEPT] and any(
        alive(words[pid]) and words[started] in {0, start_time(words[pid])} for pid, started in _OWNERS.items()
    )


def _unlink_all(path: Path) -> None:
    """The memory at `path`, and what lies beside it."""
    for suffix in (SUFFIX, _SOCKET, _FRAMES, f"{_FRAMES}.part"):
        _unlink(path.with_suffix(suffix))


def _unlink(path: Path) -> None:
    with suppress(OSError):  # it may be gone, or the folder be read-only by now
        path.unlink()


def alive(pid: int) -> bool:
    """Whether there is a process of that number that has not ended; True where the system cannot tell."""
    if not 0 < pid <= _LARGEST_PID:
        return False
    try:
        end = os.pidfd_open(pid)
    except OSError as error:
        # anything else, such as no descriptor left, does not mean that the process has ended
        return error.errno not in _NO_PROCESS and _exists(pid)
    try:
        return not has_ended(end)
    finally:
        os.close(end)


def has_ended(process: int) -> bool:
    """Whether the process of a pidfd has ended, even if its parent has not asked how yet."""
    poller = select.poll()  # select.select takes no descriptor from 1024 on
    poller.register(process, select.POLLIN)
    return bool(poller.poll(0))


def _exists(pid: int) -> bool:
    """The same without a descriptor: a process that has ended counts until its parent has asked how."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # it is another user's
        return True
    return True


def start_time(pid: int) -> int:
    """Ticks of the system's clock between its start and that of the process; 0 if that is not known."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[_START_TIME])
    except (OSError, IndexError, ValueError):
        return 0
