"""Reads sessions, whole or by their index. A damaged file raises an error; a cut one is read as far as it goes."""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, Self, overload

import numpy as np
import numpy.typing as npt

from inteco_abs.config import Check, RigConfig, parse_config
from inteco_abs.errors import ConfigError, SessionError, near_file
from inteco_abs.format import IO_TOPIC, LOG_TOPIC, PARAMETERS_TOPIC, TICK, TRUTH
from inteco_abs.sessions.container import (
    BY_CHANNEL,
    HEAD,
    LARGEST_RECORD,
    MAGIC,
    DamagedError,
    DecompressionBudget,
    Entry,
    Opcode,
    chunk_index,
    chunk_parts,
    fields,
    kind,
    unpack_chunk,
)
from inteco_abs.sessions.content import (
    CONFIG_NAME,
    FLAT,
    LIBRARY,
    Batch,
    Content,
    LogEntry,
    Parameters,
    event,
    parameters,
)
from inteco_abs.sessions.locations import is_local, opened_for_reading
from inteco_abs.sessions.migration import Metadata, UnsupportedError, migrated
from inteco_abs.sessions.rows import (
    BLOCK_TICKS,
    Chunks,
    FirstTicks,
    GatheredRows,
    Item,
    Part,
    Rows,
    RowsInMemory,
    StoredRows,
    damaged,
    in_step,
    places,
    whole,
)
from inteco_abs.sessions.scanner import RecordFile

_BEGINNING: Final = 64
"""Bytes from which the type of a file that is not a session is recognised."""
_LONGEST_S: Final = 1e9
"""Longer than any session; its nanoseconds fit into 64 bits."""
_FOOTER: Final = struct.Struct("<QQI")
_TAIL: Final = HEAD.size + _FOOTER.size + len(MAGIC)
_LISTED: Final = {Opcode.METADATA_INDEX: Opcode.METADATA, Opcode.ATTACHMENT_INDEX: Opcode.ATTACHMENT}
"""Kinds of records by the kinds of their indexes."""
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
    """The content of a session file.

    Rows of a long session are not in memory: `blocks` goes through them, `session[10.0:11.0]` is a part of them, and
    `ticks` and `truth` read all of them each time.
    """

    path: Path
    rows: Rows
    """Where ticks and truth are."""
    metadata: dict[str, dict[str, str]]
    """Metadata by record name without `inteco_abs.`; records of one name are merged, the later one wins."""
    attachments: dict[str, bytes]
    """Contents by name, such as `config.toml`."""
    channels: dict[str, dict[str, str]]
    """Metadata of each channel, by topic."""
    log: Sequence[LogEntry]
    """Changes of phase, faults and warnings, as text."""
    parameters: Sequence[Parameters]
    """Gains and reference in force, each from its tick."""
    epoch_ns: int
    """UNIX time of the monotonic clock's zero, ns; 0 without ticks."""
    incomplete: str
    """Where a cut file ends; empty for a complete one."""
    unsupported: str = ""
    """What this version does not know or does not find in it; empty if nothing. Such a session is not replayed."""
    frames: int = 0
    """Number of messages between host and board; `read_frames` reads them."""
    window_s: tuple[float, float] | None = None
    """First and last time of a part of a session, s since its first tick; None for a whole one."""
    media_types: Mapping[str, str] = field(default_factory=dict)
    """Media types of the attachments, by name."""

    @property
    def ticks(self) -> npt.NDArray[np.void]:
        """One row per tick; columns such as `time_ns`, `slip` and `brake`, with units as in `schema.TICK`.

        Raises SessionError, as `truth`, `payload`, `blocks` and a part do, if the file has changed or is damaged.
        """
        return whole(self.rows.parts())[0]

    @property
    def truth(self) -> npt.NDArray[np.void]:
        """One row per tick on a simulated board, none on a real one; columns as in `schema.TRUTH`."""
        return whole(self.rows.parts())[1]

    @property
    def payload(self) -> memoryview:
        """The ticks as messages of this version, back to back."""
        return self.ticks.view(np.uint8).data.toreadonly()

    @property
    def tick_count(self) -> int:
        """Number of ticks."""
        return self.rows.numbers[TICK.topic]

    @property
    def truth_count(self) -> int:
        """Number of rows of `truth`."""
        return self.rows.numbers[TRUTH.topic]

    @property
    def duration_s(self) -> float:
        """Time from the first to the last tick; 0 without ticks."""
        first, last = self.rows.edges()
        return (int(last["time_ns"][0]) - int(first["time_ns"][0])) * 1e-9 if len(first) else 0.0

    @property
    def events(self) -> int:
        """Lines in the log."""
        return len(self.log)

    def blocks(self, ticks: int = BLOCK_TICKS) -> Iterator[Part]:
        """All rows in blocks of `ticks` ticks, the last one shorter, each with the truth up to its last tick."""
        return in_step(self.rows.parts(), ticks, self.truth_count)

    def __getitem__(self, part: slice) -> Self:
        """The part from `start` to before `stop`, in s since the first tick, as `session[10.0:11.0]`; in memory.

        Only the chunks that hold it are read. Log and parameters stay those of the whole session. Raises ValueError for
        a step, and for an end before its start.
        """
        if part.step is not None:
            raise ValueError(f"a step of {part.step}: must be a part in seconds, as session[10.0:11.0]")
        begin_s = 0.0 if part.start is None else part.start
        end_s = math.inf if part.stop is None else part.stop
        if not 0.0 <= begin_s <= end_s:
            raise ValueError(f"{begin_s}:{end_s} s: must not be negative, and end after its start")
        first, _ = self.rows.edges()
        zero_ns = int(first["time_ns"][0]) if len(first) else 0
        first_ns, end_ns = zero_ns + round(begin_s * 1e9), zero_ns + round(min(end_s, _LONGEST_S) * 1e9)
        ticks, truth = (
            rows.view(f"V{rows.itemsize}")[(rows["time_ns"] >= first_ns) & (rows["time_ns"] < end_ns)].view(rows.dtype)
            for rows in whole(self.rows.between(first_ns, end_ns))
        )  # whole messages, with what lies between their columns
        return replace(self, rows=RowsInMemory(ticks, truth), window_s=(begin_s, end_s))

    def first(self, ticks: int) -> Self:
        """The session up to its first `ticks` ticks; the truth stays whole."""
        return replace(self, rows=FirstTicks(self.rows, ticks))

    def with_rows(self, ticks: npt.NDArray[np.void] | None = None, truth: npt.NDArray[np.void] | None = None) -> Self:
        """The session with other rows, in memory."""
        rows = RowsInMemory(self.ticks if ticks is None else ticks, self.truth if truth is None else truth)
        return replace(self, rows=rows)


class _Unread(Sequence[Item]):
    """Items of a file that are read when one of them is asked for; their number is known."""

    def __init__(self, number: int, read: Callable[[], list[Item]]) -> None:
        self._number = number
        self._read = read

    def __len__(self) -> int:
        return self._number

    @overload
    def __getitem__(self, at: int) -> Item: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Item]: ...
    def __getitem__(self, at: int | slice) -> Item | Sequence[Item]:
        return self._items[at]

    @cached_property
    def _items(self) -> list[Item]:
        return self._read()


def read_session(path: Path) -> Session:
    """The session at `path`, all of it checked. A cut file is read up to its last intact record; see `incomplete`.

    Raises SessionError if the file cannot be opened, is not a session, or is damaged.
    """
    with opened(path) as (file, size):
        content, gathered = Content(budget=DecompressionBudget(size)), GatheredRows()
        try:
            for entry, batches in _chunks(file, size, content):
                gathered.add(entry, batches)
            _require_ours(path, content)
            _check(content)
            rows = gathered.rows(path, file, content)
            return _session(path, content, rows, tuple(content.events), tuple(content.parameters))
        except UnsupportedError as error:
            raise SessionError(f"{path}: cannot be read: {error}") from error
        except DamagedError as error:
            raise damaged(path, error) from error


def open_session(path: Path) -> Session:
    """The session at `path` by its index: ticks, log and parameters are read, and checked, as they are used.

    What is not used is not checked: `read_session` and `validate` check all. A file without an intact index is read as
    by `read_session`. Raises SessionError.
    """
    with opened(path) as (file, size):
        try:
            return _indexed(path, file, size)
        except UnsupportedError as error:
            raise SessionError(f"{path}: cannot be read: {error}") from error
        except DamagedError:
            pass
    return read_session(path)


def stored_rows(file: BinaryIO, size: int, path: Path) -> Iterator[tuple[bytes, bytes]]:
    """Ticks and states of the simulated rig of the session in an open file, back to back, chunk by chunk.

    A cut file is read as far as it goes. Raises SessionError if the file at `path` is damaged.
    """
    try:
        for _, batches in _chunks(file, size, Content(budget=DecompressionBudget(size))):
            ticks, states = (batches[topic].upgraded if topic in batches else b"" for topic in FLAT)
            if ticks or states:
                yield ticks, states
    except DamagedError as error:
        raise damaged(path, error) from error


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
        _take_listed(file, size, content, chunk_parts(summary_of(file, size).records), (Opcode.METADATA_INDEX,))
    return migrated(content.metadata)


def _take_listed(
    file: BinaryIO, size: int, content: Content, summary: Iterable[object], lists: Collection[Opcode]
) -> None:
    """Read the records that indexes of the kinds `lists` point to, in the order of the file. Raises DamagedError."""
    entries = [entry for entry in summary if isinstance(entry, Entry) and entry.opcode in lists]
    places = sorted((*fields(entry.opcode, entry.data)[:2], _LISTED[Opcode(entry.opcode)]) for entry in entries)
    for at, length, opcode in places:
        if length > LARGEST_RECORD or at + length > size:
            raise DamagedError("the index points outside of the file")
        file.seek(at)
        record = file.read(length)
        if len(record) < HEAD.size or HEAD.unpack_from(record) != (opcode, length - HEAD.size):
            raise DamagedError(f"the index points to {kind(opcode)} that is not there")
        content.take(Entry(opcode, at + HEAD.size, memoryview(record)[HEAD.size :]))


def _indexed(path: Path, file: BinaryIO, size: int) -> Session:
    """The session by its index. Raises DamagedError if that cannot be used."""
    content = Content(budget=DecompressionBudget(size))
    for header in islice(RecordFile(file, size), 1):
        content.take(header)
    others, listed = chunk_index(summary_of(file, size).records)
    counted: memoryview | None = None
    for entry in others:
        if entry.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
            content.take(entry)
        elif entry.opcode == Opcode.STATISTICS:
            counted = fields(entry.opcode, entry.data)[-1]
    _take_listed(file, size, content, others, _LISTED)
    content.check_schemas()
    numbers = _counted(counted, content)
    content.frames = numbers[IO_TOPIC]
    chunks = Chunks(path, file, content, places(listed, content))
    if any(number and not chunks.has(topic) for topic, number in numbers.items() if topic != IO_TOPIC):
        raise DamagedError("the index does not say which chunks have messages that it counts")
    for raw in islice(chunks.unpacked({TICK.topic}), 1):
        content.take_chunk(raw)  # it dates the session
    rows = StoredRows(chunks, {topic: numbers[topic] for topic in FLAT})
    log = _Unread(numbers[LOG_TOPIC], lambda: chunks.messages(LOG_TOPIC, event))
    in_force = _Unread(
        numbers[PARAMETERS_TOPIC], lambda: chunks.messages(PARAMETERS_TOPIC, lambda _, data: parameters(data))
    )
    _require_ours(path, content)
    return _session(path, content, rows, log, in_force)


class Summary(NamedTuple):
    """The index at the end of a file."""

    start: int
    """Its offset, behind the record that ends the data."""
    records: bytes


def _counted(statistics: memoryview | None, content: Content) -> dict[str, int]:
    """Number of messages by topic. Raises DamagedError without valid statistics."""
    numbers = dict.fromkeys((*FLAT, LOG_TOPIC, PARAMETERS_TOPIC, IO_TOPIC), 0)
    if statistics is None or len(statistics) % BY_CHANNEL.size:
        raise DamagedError("the index does not count the messages")
    for channel, number in BY_CHANNEL.iter_unpack(statistics):
        if channel not in content.channels:
            raise DamagedError(f"the index counts messages of channel {channel}, which is not declared")
        topic, _ = content.channels[channel]
        numbers[topic] = numbers.get(topic, 0) + number
    return numbers


def summary_of(file: BinaryIO, size: int) -> Summary:
    """The records between the data and the footer. Raises DamagedError."""
    if size < _TAIL:
        raise DamagedError("there is no index")
    file.seek(size - _TAIL)
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
    return Summary(start, summary)


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
        with opened_for_reading(path) as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            yield file, size
    except OSError as error:
        why, hint = error.strerror or str(error), ""
        if isinstance(error, FileNotFoundError) and is_local(path):
            hint = near_file(path) or f"; inteco-abs list {path.parent} shows the sessions there"
        elif isinstance(error, FileNotFoundError):  # which fsspec also raises where no server answers
            why = "it is not there, or its server does not answer"
        raise SessionError(f"{path}: cannot be read: {why}{hint}") from error


def _chunks(file: BinaryIO, size: int, content: Content) -> Iterator[tuple[Entry, dict[str, Batch]]]:
    """Read all records into `content`; each chunk with its rows."""
    records = RecordFile(file, size)
    ended = False
    for entry in records:
        try:
            if entry.opcode == Opcode.DATA_END:
                check_data(entry, records.crc)
                ended = True
                break
            if entry.opcode != Opcode.CHUNK:
                content.take(entry)
                continue
            batches = content.take_chunk(unpack_chunk(entry.data, content.budget))
        except UnsupportedError:
            raise
        except DamagedError as error:
            raise DamagedError(f"{kind(entry.opcode)} at byte {entry.start}: {error}") from error
        yield entry, batches
    content.check_schemas()
    if ends_well(file, size) and size > len(MAGIC):
        if not ended:
            raise DamagedError("the head of a record is wrong: the file is not cut, but its data has no end")
    else:
        content.incomplete = f"the file ends early, after {size} bytes, without its index"


def check_data(end: Entry, found: int) -> None:
    """Raise DamagedError if the data section's checksum is neither `found` nor 0, which means not recorded."""
    (crc,) = fields(Opcode.DATA_END, end.data)
    if crc not in {0, found}:
        raise DamagedError("the data section fails its checksum")


def ends_well(file: BinaryIO, size: int) -> bool:
    """Whether the first `size` bytes of the file, which may still grow, end as an MCAP file does."""
    file.seek(size - len(MAGIC))
    return file.read(len(MAGIC)) == MAGIC


def _require_ours(path: Path, content: Content) -> None:
    """Raise SessionError unless this program, or one that keeps its channels, wrote the file."""
    ours = content.announces_ticks or content.library.startswith(LIBRARY)
    if not ours or (_recorded_hash(content) is None and not content.incomplete):
        raise SessionError(f"{path}: is an MCAP file, but not a session of this program")


def _recorded_hash(content: Content) -> str | None:
    return content.metadata.get("integrity", {}).get("payload_sha256")


def _check(content: Content) -> None:
    """Raise DamagedError unless ticks and attachments match their hashes."""
    if _recorded_hash(content) not in {None, content.hash.hexdigest()}:
        raise DamagedError("the ticks do not match the hash that was recorded with them")
    for name in content.altered_attachments():
        raise DamagedError(f"attachment {name!r} does not match the hash that was recorded with it")


def _session(
    path: Path, content: Content, rows: Rows, log: Sequence[LogEntry], in_force: Sequence[Parameters]
) -> Session:
    return Session(
        path,
        rows,
        migrated(content.metadata),
        {name: attached.data for name, attached in content.attachments.items()},
        content.channel_facts,
        log,
        in_force,
        content.epoch_ns or 0,
        content.incomplete,
        content.unsupported,
        content.frames,
        media_types={name: attached.media_type for name, attached in content.attachments.items()},
    )
