"""Reads a session into numpy arrays. A damaged file is refused; one that was cut is read up to there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import SessionError, near_file
from inteco_abs.format import TICK, TRUTH
from inteco_abs.sessions.container import (
    MAGIC,
    DamagedError,
    DecompressionBudget,
    Entry,
    Opcode,
    RecordFile,
    fields,
    kind,
    unpack_chunk,
)
from inteco_abs.sessions.content import FLAT, LIBRARY, Content, LogEntry, Parameters
from inteco_abs.sessions.migration import UnsupportedError, migrated
from inteco_abs.sessions.storage import Rows, RowsInMemory, RowsOnDisk

_BEGINNING: Final = 64
"""Bytes that show what a file is, if it is not a session."""
_LATEST_NS: Final = (1 << 63) - 1
_OTHERS: Final = {
    b"#ROSBAG": "a ROS bag; this program reads sessions of its own only",
    b"SQLite format 3": "an SQLite database, as ROS 2 bags are; this program reads sessions of its own only",
    b"\x1f\x8b": "compressed with gzip: unpack it with gunzip first",
    b"\x28\xb5\x2f\xfd": "compressed with zstd: unpack it with unzstd first",
    b"PK\x03\x04": "a zip archive: unpack it first",
    b"\x89HDF": "an HDF5 file, perhaps MATLAB's; this program reads sessions of its own only",
    b"MATLAB 5.0 MAT-file": "a MATLAB file; name the session that it was exported from",
    b"PAR1": "a Parquet file; name the session that it was exported from",
    b"inteco-abs ring": "what a run has left in memory: inteco-abs recover FILE --out OUT makes a session of it",
}
"""By their first bytes: files that people take for sessions."""


@dataclass(frozen=True, slots=True)
class Session:
    """What a session file holds. Arrays have one row per tick; columns and units as in `schema.TICK`."""

    path: Path
    ticks: npt.NDArray[np.void]
    """One row per tick; columns such as `time_ns`, `slip` and `brake`, with units as in `schema.TICK`."""
    payload: bytes | memoryview
    """The ticks as messages of this version, back to back; those of the file itself if they are of no other."""
    truth: npt.NDArray[np.void]
    """One row per tick on a simulated board, no rows on a real one; columns as in `schema.TRUTH`."""
    metadata: dict[str, dict[str, str]]
    """By record name without `inteco_abs.`; records of one name are merged, the later one wins."""
    attachments: dict[str, bytes]
    """Contents by name, such as `config.toml`."""
    channels: dict[str, dict[str, str]]
    """Metadata of each channel, by topic."""
    log: tuple[LogEntry, ...]
    """Changes of phase, faults and warnings, as text."""
    parameters: tuple[Parameters, ...]
    """Gains and reference in force, each from its tick on."""
    epoch_ns: int
    """UNIX time of the monotonic clock's zero, ns; 0 without ticks."""
    incomplete: str
    """Empty for a whole file, else where it ends."""
    unsupported: str = ""
    """Empty if this version knows and finds all that it should, else what not: such a session is not replayed."""
    frames: int = 0
    """Messages between host and board, which only `read_frames` reads."""

    @property
    def events(self) -> int:
        """Lines in the log."""
        return len(self.log)


def read_session(path: Path, spool: Path | None = None) -> Session:
    """The session at `path`. A file that was cut is read up to its last whole record and says so in `incomplete`.

    With the folder `spool`, the rows lie in an unnamed file there rather than in memory: an hour has 1.5 GB of them.
    Raises SessionError if the file cannot be opened, is not a session, or is damaged.
    """
    with opened(path) as (file, size), ExitStack() as files:
        try:
            rows: dict[str, Rows] = {
                topic: RowsInMemory() if spool is None else files.enter_context(RowsOnDisk(spool)) for topic in FLAT
            }
            content, incomplete = _read(file, size, Content(rows, DecompressionBudget(size)))
            return _session(path, content, incomplete)
        except UnsupportedError as error:
            raise SessionError(f"{path}: cannot be read: {error}") from error
        except DamagedError as error:
            raise _damaged(path, error) from error


def stored_rows(file: BinaryIO, size: int, path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Ticks and states of the simulated rig of the session in an open file, back to back, chunk by chunk.

    Up to where it was cut, as `read_session` does it. Raises SessionError if the file at `path` is damaged.
    """
    content = Content(budget=DecompressionBudget(size))
    try:
        for entry in RecordFile(file, size):
            if entry.opcode == Opcode.DATA_END:
                return
            if entry.opcode != Opcode.CHUNK:
                content.take(entry)
                continue
            batches = content.take_chunk(unpack_chunk(entry.data, content.budget))
            ticks, states = (batches[topic].upgraded if topic in batches else b"" for topic in FLAT)
            if ticks or states:
                yield ticks, states
    except DamagedError as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: DamagedError) -> SessionError:
    return SessionError(f"{path}: is damaged: {error}; inteco-abs recover saves the ticks that are whole")


@contextmanager
def opened(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """The regular file at `path`, which begins as an MCAP file does, and its size. Raises SessionError."""
    with regular_file(path) as (file, size):
        head = file.read(len(MAGIC))
        if head != MAGIC:
            file.seek(0)
            raise SessionError(f"{path}: is not an MCAP file, it {_instead(file.read(_BEGINNING), len(head))}")
        file.seek(0)
        yield file, size


def is_session_file(path: Path) -> bool:
    """Whether `path` is a regular file that begins as a session does; a pipe is never opened."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def _instead(begin: bytes, shown: int) -> str:
    """Description of a file by its first bytes, or these bytes."""
    if not begin:
        return "is empty: the run may not have started"
    for other, what in _OTHERS.items():
        if begin.startswith(other):
            return f"is {what}"
    if MAGIC.startswith(begin):
        return f"is cut off after {len(begin)} bytes, within what every MCAP file begins with"
    letters = begin.decode("utf-8", "replace")
    text = ", as text does" if all(letter.isprintable() or letter.isspace() for letter in letters) else ""
    return f"starts with {begin[:shown]!r}{text}; give a session that inteco-abs run wrote"


@contextmanager
def regular_file(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """The file at `path` and its size, if it is one that can be read. Raises SessionError."""
    try:
        if path.exists() and not path.is_file():
            what = f" but a folder, which inteco-abs list {path} shows" if path.is_dir() else ""
            raise SessionError(f"{path}: cannot be read: it is not a regular file{what}")
        with path.open("rb") as file:
            yield file, os.fstat(file.fileno()).st_size
    except OSError as error:
        near = near_file(path) if isinstance(error, FileNotFoundError) else ""
        raise SessionError(f"{path}: cannot be read: {error.strerror}{near}") from error


def _read(file: BinaryIO, size: int, content: Content) -> tuple[Content, str]:
    """All records into `content`, and where the file ends if that is too early."""
    records = RecordFile(file, size)
    ended = False
    for entry in records:
        try:
            if entry.opcode == Opcode.DATA_END:
                check_data(entry, records.crc)
                ended = True
                break
            if entry.opcode == Opcode.CHUNK:
                content.take_chunk(unpack_chunk(entry.data, content.budget))
            else:
                content.take(entry)
        except UnsupportedError:
            raise
        except DamagedError as error:
            raise DamagedError(f"{kind(entry.opcode)} at byte {entry.start}: {error}") from error
    content.check_schemas()
    if ends_well(file) and size > len(MAGIC):
        if not ended:
            raise DamagedError("the head of a record is wrong: the file is not cut, and its data have no end")
        return content, ""
    return content, f"the file ends early, after {size} bytes, without its index"


def check_data(end: Entry, found: int) -> None:
    """Raises DamagedError if the data section's checksum is not the one that was `found`; 0 says nothing."""
    (crc,) = fields(Opcode.DATA_END, end.data)
    if crc not in {0, found}:
        raise DamagedError("the data section fails its checksum")


def ends_well(file: BinaryIO) -> bool:
    """Whether the file ends as an MCAP file does."""
    file.seek(-len(MAGIC), os.SEEK_END)
    return file.read() == MAGIC


def _check_times(times_ns: npt.NDArray[np.uint64]) -> None:
    """Raises DamagedError at a time from which none can be subtracted in 64 bits: 292 years of any clock."""
    latest_ns = int(times_ns.max(initial=0))
    if latest_ns > _LATEST_NS:
        raise DamagedError(f"a tick's time is {latest_ns} ns, and no clock shows more than {_LATEST_NS}")


def _session(path: Path, content: Content, incomplete: str) -> Session:
    recorded = content.metadata.get("integrity", {}).get("payload_sha256")
    ours = content.announces_ticks or content.library.startswith(LIBRARY)
    if not ours or (recorded is None and not incomplete):
        raise SessionError(f"{path}: is an MCAP file, but not a session of this program")
    if recorded is not None and recorded != content.hash.hexdigest():
        raise DamagedError("the ticks do not match the hash that was recorded with them")
    for name in content.altered_attachments():
        raise DamagedError(f"attachment {name!r} does not match the hash that was recorded with it")
    payload = content.rows[TICK.topic].contents()
    ticks, truth = TICK.array(payload), TRUTH.array(content.rows[TRUTH.topic].contents())
    for rows in (ticks, truth):
        _check_times(rows["time_ns"])
    return Session(
        path,
        ticks,
        payload,
        truth,
        migrated(content.metadata),
        {name: attached.data for name, attached in content.attachments.items()},
        content.channel_facts,
        tuple(content.events),
        tuple(content.parameters),
        content.epoch_ns or 0,
        incomplete,
        content.unsupported,
        content.frames,
    )
