"""Shared memory of one run: words, notes and two rings, in one file in memory that outlives every process.

There is no lock. Every word has one writer at a time; readers poll.
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
import sys
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

FOLDER: Final = Path("/dev/shm")  # noqa: S108  shared memory; the name is unique
SUFFIX: Final = ".ring"
_PREFIX: Final = "inteco-abs-"
_SOCKET: Final = ".board"
_FRAMES: Final = ".frames"
_KIND: Final = b"inteco-abs ring"
_MAGIC: Final = _KIND + b" 3\n"
_HEADER: Final = struct.Struct("<32s4Q")
_POLL_S: Final = 0.001
_CHANGE: Final = struct.Struct("<2qd")
"""Tick, number of a gain, its new value."""
_BITS: Final = struct.Struct("<q")
_NUMBER: Final = struct.Struct("<d")
MOST_CHANGES: Final = 4096
"""Changes of gains in one run."""
_NO_PROCESS: Final = (errno.ESRCH, errno.EINVAL, errno.ENOENT)
"""Errors of pidfd_open for no process, or for a thread's number (ENOENT since Linux 6.9)."""
_LARGEST_PID: Final = (1 << 31) - 1
_START_TIME: Final = 19
"""Field of /proc/PID/stat, counted from 0 behind the name (proc(5): field 22)."""


class Field(IntEnum):
    """Eight-byte words, by their writer.

    The drill writes in the loop's place before the run, the supervisor in a dead guardian's place.
    """

    # the supervisor
    SUPERVISOR_PID = 0
    SUPERVISOR_BEAT_NS = auto()
    GUARDED_PID = auto()
    """Process that the guardian has to watch."""
    LOOP_PID = auto()
    RECORDER_PID = auto()
    STOP = auto()
    """Reason of the operator's side for ending the run."""
    GO = auto()
    """1 once the loop may begin."""
    OVER = auto()
    """1 once nothing is left to guard."""
    # the process that holds the board: first the one of the drill, then the loop
    HOLDER_PID = auto()
    """Set before the board is opened, 0 again once SAFE has been read back."""
    READY = auto()
    """Pid of the holder once its board is open and safe."""
    # the guardian
    GUARDIAN_BEAT_NS = auto()
    GUARDING_PID = auto()
    """Process that the guardian watches."""
    GUARDIAN_STOP = auto()
    """Reason of the guardian for ending the run."""
    RESCUED_PID = auto()
    """Process whose board was taken over last; the note RESCUE has the result."""
    SAVING = auto()
    """1 while the loop's process, its board closed, writes the recorded messages."""
    # the recorder
    RECORDER_BEAT_NS = auto()
    RECORDING = auto()
    """1 once the session's header is on the disk."""
    SYNCED = auto()
    """Number of ticks that are on the disk."""
    LIVE_PORT = auto()
    """TCP port of the live view; 0 without one."""
    TROUBLES = auto()
    """Number of refusals by a disk: see the note TROUBLES."""
    # the supervisor again
    KEPT = auto()
    """1 once it has decided that the ticks stay here."""
    EPOCH_NS = auto()
    """UNIX time of the monotonic clock's zero, ns."""
    UNRECORDED = auto()
    """1 if the ticks are for a screen only, and not recorded."""
    # the panel's screen
    REQUESTED_DRIVE = auto()
    """Duty, in millionths."""
    REQUESTED_BRAKE = auto()
    KEY_SEEN_NS = auto()
    """Monotonic time at which the key that keeps the outputs on was last seen."""
    LOOKS_ASKED = auto()
    """Number of readings of the whole board that it has requested."""
    # the process that holds the board for the panel
    LOOKS = auto()
    """Number of the reading in the note RESULT."""
    # the first process to warn
    ALARMED = auto()
    """1 once the user was warned that the board is held without a loop that drives it."""
    # start times of the run's processes, since the system may give their numbers to others later
    SUPERVISOR_STARTED = auto()
    """Start of the supervisor, as `start_time` returns it; 0 if not known."""
    LOOP_STARTED = auto()
    RECORDER_STARTED = auto()
    # the supervisor, for a person who changes a gain
    CHANGES_ASKED = auto()
    """Number of changes that were asked for; set last."""
    ASKED_GAIN = auto()
    """Number of the gain: 0 is the reference slip, then come those that the controller declares."""
    ASKED_VALUE = auto()
    """Its new value: the bits of a double."""
    # the loop
    CHANGES_ANSWERED = auto()
    """Number of the request that it has answered; set last."""
    ANSWER_TICK = auto()
    """Tick from which on the change holds; -1: it was refused."""
    CHANGES = auto()
    """Changes of gains so far, planned ones included."""


class Mailbox(IntEnum):
    """Texts and images that one process posts for the others."""

    JOB = 0
    HEADER = auto()
    SAFE_IMAGE = auto()
    DRILL = auto()
    """Result of the guardian's drill."""
    RUN_END = auto()
    FAILURE = auto()
    """Why the loop's process ended before or after the run."""
    RECORDER_FAILURE = auto()
    RESCUE = auto()
    RESULT = auto()
    ENVIRONMENT = auto()
    """Packages and changes of the source tree, which take too long to be gathered twice."""
    INJECTED = auto()
    """How often each fault of the mock board has acted."""
    TROUBLES = auto()
    """The recorder's reports on its disks, and the file that it writes now."""


_NOTE_BYTES: Final = {Mailbox.JOB: 2 << 20, Mailbox.ENVIRONMENT: 2 << 20, Mailbox.HEADER: 256 << 10}
_OTHER_NOTE_BYTES: Final = 64 << 10
_WORDS_AT: Final = 4096
_NOTES_AT: Final = 8192
_OWNERS: Final = {
    Field.SUPERVISOR_PID: Field.SUPERVISOR_STARTED,
    Field.LOOP_PID: Field.LOOP_STARTED,
    Field.RECORDER_PID: Field.RECORDER_STARTED,
}
"""Words with the number and the start time of each process of the run."""


def _note_places() -> tuple[dict[Mailbox, tuple[int, int]], int]:
    places, at = {}, _NOTES_AT
    for note in Mailbox:
        size = _NOTE_BYTES.get(note, _OTHER_NOTE_BYTES)
        places[note] = at, size
        at += size
    return places, at


_NOTES, _HISTOGRAM_AT = _note_places()
_CHANGES_AT: Final = _HISTOGRAM_AT + Histogram.BYTES
_RINGS_AT: Final = -(-(_CHANGES_AT + MOST_CHANGES * _CHANGE.size) // 4096) * 4096


def run_bytes(tick_bytes: int, tick_capacity: int, truth_bytes: int, truth_capacity: int) -> int:
    """Return the size in bytes of the memory for rings of these record sizes and capacities."""
    return _RINGS_AT + ring_bytes(tick_bytes, tick_capacity) + ring_bytes(truth_bytes, truth_capacity)


def require_room(size: int) -> None:
    """Raise SessionError unless `size` bytes of shared memory are free; takes none."""
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
        """Create the memory of a new run. Raises SessionError if there is not enough."""
        size = run_bytes(tick_bytes, tick_capacity, truth_bytes, truth_capacity)
        path = FOLDER / f"{_PREFIX}{uuid.uuid4()}{SUFFIX}"
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
            try:
                os.posix_fallocate(file, 0, size)  # now: later it would be a bus error
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
        """Create memory of this process alone, without a file, for a board held here in virtual time."""
        mapping = mmap.mmap(-1, run_bytes(tick_bytes, tick_capacity, 1, 1))
        _HEADER.pack_into(mapping, 0, _MAGIC, tick_bytes, tick_capacity, 1, 1)
        return cls(Path(), mapping)

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open the memory of a run; raises SessionError if `path` is another file or cannot be opened."""
        try:
            file = os.open(path, os.O_RDWR)
            try:
                size = os.fstat(file).st_size
                if size < _RINGS_AT or os.pread(file, len(_MAGIC), 0) != _MAGIC:
                    raise SessionError(f"{path}: not a tick ring of this version")
                # every page now: the loop must not meet a page fault
                mapping = mmap.mmap(file, size, flags=mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
            finally:
                os.close(file)
        except OSError as error:
            raise SessionError(f"{path}: {error.strerror or error}") from error
        _, tick_bytes, ticks, truth_bytes, truths = _HEADER.unpack_from(mapping)
        if size != _RINGS_AT + ring_bytes(tick_bytes, ticks) + ring_bytes(truth_bytes, truths):
            raise SessionError(f"{path}: has {size} bytes, not what its header says: the file was cut off")
        return cls(path, mapping)

    def keep(self) -> None:
        """Make `remove` do nothing: the ticks are nowhere else."""
        self._kept = True
        self.words[Field.KEPT] = 1
        _unlink(self.socket)

    def remove(self) -> None:
        """Unlink the memory and the files beside it; a copy elsewhere is the user's own, and stays."""
        if self._kept or FOLDER.resolve() not in self.path.resolve().parents:
            return
        _unlink_all(self.path)

    @property
    def socket(self) -> Path:
        """Socket at which the mock board of this run listens."""
        return self.path.with_suffix(_SOCKET)

    @property
    def frames(self) -> Path:
        """File in which the loop's process saves the raw frames, if the job asks for them."""
        return self.path.with_suffix(_FRAMES)

    def name(self, owner: Field, pid: int) -> None:
        """Enter process `pid` as the run's `owner`: SUPERVISOR_PID, LOOP_PID or RECORDER_PID."""
        self.words[_OWNERS[owner]] = start_time(pid)
        self.words[owner] = pid

    def in_use(self) -> bool:
        """Return whether any process of the run may still need the memory."""
        return _in_use(self.words)

    def post(self, note: Mailbox, content: Any) -> None:
        """Post a note: bytes, or what JSON can hold. Raises SessionError if it is too long."""
        data = content if isinstance(content, bytes) else json.dumps(content).encode()
        at, size = _NOTES[note]
        if len(data) > size - 8:
            raise SessionError(f"{note.name.lower()} of {len(data)} bytes is too long: at most {size - 8}")
        struct.pack_into("<Q", self._memory, at, 0)
        self._memory[at + 8 : at + 8 + len(data)] = data
        struct.pack_into("<Q", self._memory, at, len(data) + 1)  # last: a note is there whole or not at all

    def image(self, note: Mailbox) -> bytes | None:
        """Return a note's bytes; None if it was not posted yet, or is just being replaced."""
        at, _ = _NOTES[note]
        (length,) = struct.unpack_from("<Q", self._memory, at)
        data = bytes(self._memory[at + 8 : at + 7 + length]) if length else None
        return data if struct.unpack_from("<Q", self._memory, at) == (length,) else None

    def note(self, note: Mailbox) -> Any:
        """Return a note; None if it was not posted yet."""
        data = self.image(note)
        return None if data is None else json.loads(data)

    def ask_change(self, gain: int, value: float) -> int:
        """Ask the loop to change a gain; return the request's number. The one before must have been answered."""
        words = self.words
        words[Field.ASKED_GAIN] = gain
        (words[Field.ASKED_VALUE],) = _BITS.unpack(_NUMBER.pack(value))
        words[Field.CHANGES_ASKED] = number = words[Field.CHANGES_ASKED] + 1
        return number

    def asked_change(self) -> tuple[int, float]:
        """Number of the gain that shall change, and its new value."""
        (value,) = _NUMBER.unpack(_BITS.pack(self.words[Field.ASKED_VALUE]))
        return self.words[Field.ASKED_GAIN], value

    def add_change(self, tick: int, gain: int, value: float) -> None:
        """Keep a change of a gain for the recorder; `MOST_CHANGES` have room."""
        number = self.words[Field.CHANGES]
        _CHANGE.pack_into(self._memory, _CHANGES_AT + number * _CHANGE.size, tick, gain, value)
        self.words[Field.CHANGES] = number + 1  # last: a change is there whole or not at all

    def changes(self, first: int = 0) -> list[tuple[int, int, float]]:
        """Tick, number of the gain and new value of each change from number `first` on."""
        places = (_CHANGES_AT + number * _CHANGE.size for number in range(first, self.words[Field.CHANGES]))
        return [_CHANGE.unpack_from(self._memory, at) for at in places]

    def tick_ring(self, pack: Pack, first: int = 0) -> TickRing:
        """Return the writer of the ticks, whose first record has the number `first`."""
        return TickRing(pack, self._tick_bytes, self.tick_capacity, self._ticks, first)

    def tick_reader(self) -> RingReader:
        """Return a reader of the ticks."""
        return RingReader(self._ticks, self._tick_bytes, self.tick_capacity)

    def truth_ring(self, pack: Pack, first: int = 0) -> TickRing:
        """Return the writer of the simulated rig's states, whose first record has the number `first`."""
        return TickRing(pack, self._truth_bytes, self._truth_capacity, self._truths, first)

    def truth_reader(self) -> RingReader:
        """Return a reader of the simulated rig's states."""
        return RingReader(self._truths, self._truth_bytes, self._truth_capacity)

    def wait(self, condition: Callable[[], object], most_s: float) -> bool:
        """Poll until `condition()` is true; return False after `most_s`."""
        end = time.monotonic() + most_s
        while not condition():
            if time.monotonic() > end:
                return False
            time.sleep(_POLL_S)
        return True


def is_ring(path: Path) -> bool:
    """Return whether a file is the memory of a run, of any version."""
    try:
        if not path.is_file():  # opening a pipe would wait for its writer
            return False
        with path.open("rb") as file:
            return file.read(len(_KIND)) == _KIND
    except OSError:
        return False


def left_rings(folder: Path = FOLDER) -> Iterator[Path]:
    """Yield the memories of this user's runs whose processes all ended before the session was complete.

    Removes memories without ticks to be kept. Reads only the first words of each, as a memory may be large.
    """
    if sys.platform == "win32":  # there is no run in real time
        return
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
    """Return the first bytes of this user's regular file, else nothing: all users may put pipes and links there."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
        try:
            found = os.fstat(file)
            own = stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid()
            return os.pread(file, _RINGS_AT + 8, 0) if own else b""
        finally:
            os.close(file)
    except OSError:
        return b""  # removed meanwhile


def _in_use(words: memoryview) -> bool:
    """Return whether a process of the run still lives; a kept memory needs none."""
    return not words[Field.KEPT] and any(
        alive(words[pid]) and words[started] in {0, start_time(words[pid])} for pid, started in _OWNERS.items()
    )


def _unlink_all(path: Path) -> None:
    """Unlink the memory at `path` and the files beside it."""
    for suffix in (SUFFIX, _SOCKET, _FRAMES, f"{_FRAMES}.part"):
        _unlink(path.with_suffix(suffix))


def _unlink(path: Path) -> None:
    with suppress(OSError):  # it may be gone, or the folder read-only
        path.unlink()


def alive(pid: int) -> bool:
    """Return whether process `pid` exists and has not ended; True where the system cannot say."""
    if not 0 < pid <= _LARGEST_PID:
        return False
    try:
        end = os.pidfd_open(pid)
    except AttributeError:  # macOS
        return _exists(pid)
    except OSError as error:
        # another error, such as no descriptor left, does not mean that the process has ended
        return error.errno not in _NO_PROCESS and _exists(pid)
    try:
        return not has_ended(end)
    finally:
        os.close(end)


def has_ended(process: int) -> bool:
    """Return whether the process of a pidfd has ended, even if its parent has not waited for it."""
    poller = select.poll()  # select.select accepts no descriptor from 1024 on
    poller.register(process, select.POLLIN)
    return bool(poller.poll(0))


def _exists(pid: int) -> bool:
    """Return whether process `pid` exists; a zombie counts."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # another user's
        pass
    return True


def start_time(pid: int) -> int:
    """Return when the process started, in clock ticks since boot; 0 if not known."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[_START_TIME])
    except (OSError, IndexError, ValueError):
        return 0
