"""Reads a session into numpy arrays. A damaged file raises an error; a cut one is read as far as it goes."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.config import Check, RigConfig, parse_config
from inteco_abs.errors import ConfigError, SessionError, near_file
from inteco_abs.format import TICK, Message
from inteco_abs.sessions.container import (
    HEAD,
    LARGEST_RECORD,
    MAGIC,
    DamagedError,
    DecompressionBudget,
    Entry,
    Opcode,
    chunk_parts,
    fields,
    kind,
    unpack_chunk,
)
from inteco_abs.sessions.content import CONFIG_NAME, FLAT, LIBRARY, Content, LogEntry, Parameters
from inteco_abs.sessions.migration import Metadata, UnsupportedError, migrated
from inteco_abs.sessions.scanner import RecordFile
from inteco_abs.sessions.storage import ColumnsInMemory, Rows, RowsInMemory, RowsOnDisk

_BEGINNING: Final = 64
"""Bytes from which the type of a file that is not a session is recognised."""
_LATEST_NS: Final = (1 << 63) - 1
_FOOTER: Final = struct.Struct("<QQI")
_TAIL: Final = HEAD.size + _FOOTER.size + len(MAGIC)
_LARGEST_METADATA: Final = 1 << 22
_OTHERS: Final = {
    b"#ROSBAG": "a ROS bag; this program reads only its own sessions",
    b"SQLite format 3": "an SQLite database, as ROS 2 bags are; this program reads only its own sessions",
    b"\x1f\x8b": "compressed with gzip: unpack it with gunzip first",
    b"\x28\xb5\x2f\xfd": "compressed with zstd: unpack it with unzstd first",
    b"PK\x03\x04": "a zip archive: unpack it first",
    b"\x89HDF": "an HDF5 file, perhaps MATLAB's; this program reads only its own sessions",
    b"MATLAB 5.0 MAT-file": "a MATLAB file; name the session that it was exported from",
    b"PAR1": "a Parquet file; name the session that it was exported from",
    b"inteco-abs ring": "the memory of a run: inteco-abs recover FILE --out OUT makes a session of it",
}
"""Other types of files by their first bytes."""


@dataclass(frozen=True, slots=True)
class Session:
    """The content of a session file."""

    path: Path
    ticks: npt.NDArray[np.void]
    """One row per tick; columns such as `time_ns`, `slip` and `brake`, with units as in `schema.TICK`."""
    payload: bytes | memoryview
    """The ticks as messages of this version, back to back."""
    truth: npt.NDArray[np.void]
    """One row per tick on a simulated board, none on a real one; columns as in `schema.TRUTH`."""
    metadata: dict[str, dict[str, str]]
    """Metadata by record name without `inteco_abs.`; records of one name are merged, the later one wins."""
    attachments: dict[str, bytes]
    """Contents by name, such as `config.toml`."""
    channels: dict[str, dict[str, str]]
    """Metadata of each channel, by topic."""
    log: tuple[LogEntry, ...]
    """Changes of phase, faults and warnings, as text."""
    parameters: tuple[Parameters, ...]
    """Gains and reference in force, each from its tick."""
    epoch_ns: int
    """UNIX time of the monotonic clock's zero, ns; 0 without ticks."""
    incomplete: str
    """Where a cut file ends; empty for a complete one."""
    unsupported: str = ""
    """What this version does not know or does not find in it; empty if nothing. Such a session is not replayed."""
    frames: int = 0
    """Number of messages between host and board; `read_frames` reads them."""

    @property
    def events(self) -> int:
        """Lines in the log."""
        return len(self.log)


def read_session(path: Path, spool: Path | None = None, columns: Collection[str] | None = None) -> Session:
    """The session at `path`. A cut file is read up to its last intact record, and `incomplete` says where that is.

    With the folder `spool`, rows are kept in an unnamed file there, not in memory: an hour has 1.5 GB. With `columns`,
    ticks and truth have only these, and `payload` is empty.
    Raises SessionError if the file cannot be opened, is not a session, or is damaged.
    """
    with opened(path) as (file, size), ExitStack() as files:
        try:
            rows: dict[str, Rows] = {}
            for topic, message in FLAT.items():
                if columns is not None:
                    rows[topic] = ColumnsInMemory(message.dtype, columns)
                else:
                    rows[topic] = RowsInMemory() if spool is None else files.enter_context(RowsOnDisk(spool))
            content, incomplete = _read(file, size, Content(rows, DecompressionBudget(size)))
            return _session(path, content, incomplete)
        except UnsupportedError as error:
            raise SessionError(f"{path}: cannot be read: {error}") from error
        except DamagedError as error:
            raise _damaged(path, error) from error


def stored_rows(file: BinaryIO, size: int, path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Ticks and states of the simulated rig of the session in an open file, back to back, chunk by chunk.

    A cut file is read as far as it goes. Raises SessionError if the file at `path` is damaged.
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


def session_config(session: Session, checks: tuple[Check, ...]) -> RigConfig:
    """The configuration that the session was run with. Raises SessionError if it is missing or not valid here."""
    stored = session.attachments.get(CONFIG_NAME)
    if stored is None:
        raise SessionError(f"{session.path}: has no {CONFIG_NAME}, so it cannot be replayed")
    try:
        return parse_config(stored.decode("utf-8"), checks)
    except (ConfigError, UnicodeDecodeError) as error:
        raise SessionError(f"{session.path}: its {CONFIG_NAME} cannot be used here: {error}") from error


def read_metadata(path: Path) -> Metadata:
    """Metadata of the session at `path`, through the index, without its ticks: hundreds of files take a second.

    Only the checksum of the index is checked; `validate` checks all. Raises DamagedError if the index is damaged,
    SessionError if the file cannot be opened or is not an MCAP file.
    """
    content = Content()
    with opened(path) as (file, size):
        places = sorted(
            tuple(fields(entry.opcode, entry.data)[:2])
            for entry in _summary(file, size)
            if entry.opcode == Opcode.METADATA_INDEX
        )
        for at, length in places:
            if length > _LARGEST_METADATA or at + length > size:
                raise DamagedError("the index points outside of the file")
            file.seek(at)
            record = file.read(length)
            if len(record) < HEAD.size or HEAD.unpack_from(record) != (Opcode.METADATA, length - HEAD.size):
                raise DamagedError("the index points to metadata that is not there")
            content.take(Entry(Opcode.METADATA, at + HEAD.size, memoryview(record)[HEAD.size :]))
    return migrated(content.metadata)


def _summary(file: BinaryIO, size: int) -> Iterator[Entry]:
    """Records between the data and the footer."""
    if size < _TAIL:
        raise DamagedError("there is no index")
    file.seek(-_TAIL, os.SEEK_END)
    tail = file.read(_TAIL)
    start, _, crc = _FOOTER.unpack_from(tail, HEAD.size)
    end = size - _TAIL
    if not tail.startswith(HEAD.pack(Opcode.FOOTER, _FOOTER.size)) or not tail.endswith(MAGIC):
        raise DamagedError("there is no index")
    if not 0 < end - start <= LARGEST_RECORD:
        raise DamagedError("the index is not where the footer says")
    file.seek(start)
    summary = file.read(end - start)
    if crc != zlib.crc32(tail[: HEAD.size + _FOOTER.size - 4], zlib.crc32(summary)):
        raise DamagedError("the index fails its checksum")
    return (part for part in chunk_parts(summary) if isinstance(part, Entry))


def _damaged(path: Path, error: DamagedError) -> SessionError:
    return SessionError(f"{path}: is damaged: {error}; inteco-abs recover saves the intact ticks")


@contextmanager
def opened(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """The MCAP file at `path` and its size. Raises SessionError if it is not one."""
    with regular_file(path) as (file, size):
        head = file.read(len(MAGIC))
        if head != MAGIC:
            file.seek(0)
            raise SessionError(f"{path}: is not an MCAP file, it {_instead(file.read(_BEGINNING), len(head))}")
        file.seek(0)
        yield file, size


def is_session_file(path: Path) -> bool:
    """Whether `path` is an MCAP file; a pipe is never opened."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def _instead(begin: bytes, shown: int) -> str:
    """What a file is by its first bytes, or these bytes."""
    if not begin:
        return "is empty: the run may not have started"
    for other, what in _OTHERS.items():
        if begin.startswith(other):
            return f"is {what}"
    if MAGIC.startswith(begin):
        return f"is cut off after {len(begin)} bytes, before the end of an MCAP file's first bytes"
    letters = begin.decode("utf-8", "replace")
    text = ", as text does" if all(letter.isprintable() or letter.isspace() for letter in letters) else ""
    return f"starts with {begin[:shown]!r}{text}; give a session that inteco-abs run wrote"


@contextmanager
def regular_file(path: Path) -> Iterator[tuple[BinaryIO, int]]:
    """The regular file at `path` and its size. Raises SessionError if it cannot be read."""
    try:
        if path.exists() and not path.is_file():
            what = f" but a folder, which inteco-abs list {path} shows" if path.is_dir() else ""
            raise SessionError(f"{path}: cannot be read: it is not a regular file{what}")
        with path.open("rb") as file:
            yield file, os.fstat(file.fileno()).st_size
    except OSError as error:
        hint = ""
        if isinstance(error, FileNotFoundError):
            hint = near_file(path) or f"; inteco-abs list {path.parent} shows the sessions there"
        raise SessionError(f"{path}: cannot be read: {error.strerror}{hint}") from error


def _read(file: BinaryIO, size: int, content: Content) -> tuple[Content, str]:
    """Read all records into `content`; return it, and where the file ends if it was cut."""
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
            raise DamagedError("the head of a record is wrong: the file is not cut, but its data has no end")
        return content, ""
    return content, f"the file ends early, after {size} bytes, without its index"


def check_data(end: Entry, found: int) -> None:
    """Raise DamagedError if the data section's checksum is neither `found` nor 0, which means not recorded."""
    (crc,) = fields(Opcode.DATA_END, end.data)
    if crc not in {0, found}:
        raise DamagedError("the data section fails its checksum")


def ends_well(file: BinaryIO) -> bool:
    """Whether the file ends as an MCAP file does."""
    file.seek(-len(MAGIC), os.SEEK_END)
    return file.read() == MAGIC


def _check_times(times_ns: npt.NDArray[np.uint64]) -> None:
    """Raise DamagedError at a time above 292 years, whose differences do not fit into 64 bits."""
    latest_ns = int(times_ns.max(initial=0))
    if latest_ns > _LATEST_NS:
        raise DamagedError(f"a tick's time is {latest_ns} ns: must be at most {_LATEST_NS} ns")


def _array(message: Message, rows: Rows) -> npt.NDArray[np.void]:
    return rows.array() if isinstance(rows, ColumnsInMemory) else message.array(rows.contents())


def _session(path: Path, content: Content, incomplete: str) -> Session:
    recorded = content.metadata.get("integrity", {}).get("payload_sha256")
    ours = content.announces_ticks or content.library.startswith(LIBRARY)
    if not ours or (recorded is None and not incomplete):
        raise SessionError(f"{path}: is an MCAP file, but not a session of this program")
    if recorded is not None and recorded != content.hash.hexdigest():
        raise DamagedError("the ticks do not match the hash that was recorded with them")
    for name in content.altered_attachments():
        raise DamagedError(f"attachment {name!r} does not match the hash that was recorded with it")
    stored = content.rows[TICK.topic]
    payload = b"" if isinstance(stored, ColumnsInMemory) else stored.contents()
    ticks, truth = (_array(message, content.rows[topic]) for topic, message in FLAT.items())
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
