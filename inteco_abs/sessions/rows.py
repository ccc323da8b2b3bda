"""Rows of a session: ticks, and states of the simulated rig. Few are in memory, many are read in parts."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import SessionError
from inteco_abs.format import LOG_TOPIC, PARAMETERS_TOPIC, TICK, TRUTH
from inteco_abs.sessions.container import (
    HEAD,
    DamagedError,
    DecompressionBudget,
    Entry,
    Opcode,
    fields,
    unpack_chunk,
)
from inteco_abs.sessions.content import FLAT, Batch, Content
from inteco_abs.sessions.locations import opened_for_reading
from inteco_abs.signals import Phase

BLOCK_TICKS: Final = 1 << 16
"""Ticks of a block: 33 s at 2 kHz, 26 MB with the states of the simulated rig."""
MOST_IN_MEMORY: Final = 1 << 26
"""Bytes of rows that stay in memory when a file was read: about a minute and a half at 2 kHz on a simulated board."""

_LATEST_NS: Final = (1 << 63) - 1

Array = npt.NDArray[np.void]
Item = TypeVar("Item")
Part = tuple[Array, Array]
"""Ticks, and states of the simulated rig, as they follow each other in a file."""


class PhaseSpan(NamedTuple):
    """Ticks from index `first` to before `end`, all in one phase."""

    phase: Phase
    first: int
    end: int
    first_ns: int
    last_ns: int
    """Times of its first and last tick."""


class Rows(ABC):
    """Ticks and states of the simulated rig."""

    numbers: Mapping[str, int]
    """Number of rows by topic."""

    @abstractmethod
    def parts(self) -> Iterator[Part]:
        """All rows in order, in parts of any sizes. Raises SessionError if the file cannot be read or is damaged."""

    def between(self, first_ns: int, end_ns: int) -> Iterator[Part]:  # noqa: ARG002  all is more than enough
        """Parts with at least all rows from `first_ns` to before `end_ns` of the ticks' clock. Raises SessionError."""
        return self.parts()

    def edges(self) -> tuple[Array, Array]:
        """First and last tick, each as an array of at most one row. Raises SessionError."""
        ticks, _ = whole(self.parts())
        return ticks[:1], ticks[-1:]

    @cached_property
    def phases(self) -> Sequence[PhaseSpan]:
        """Phases in order. Raises SessionError."""
        spans = _Phases()
        for ticks, _ in self.parts():
            spans.add(ticks)
        return spans.found


class _Phases:
    """Phases of ticks that come part by part."""

    def __init__(self) -> None:
        self.found: list[PhaseSpan] = []
        self._ticks = 0

    def add(self, ticks: Array) -> None:
        phases, times_ns = ticks["phase"], ticks["time_ns"]
        edges = [0, *(np.flatnonzero(np.diff(phases)) + 1).tolist(), len(phases)]
        for first, end in pairwise(edges if len(ticks) else ()):
            span = PhaseSpan(
                Phase(phases[first]),
                self._ticks + first,
                self._ticks + end,
                int(times_ns[first]),
                int(times_ns[end - 1]),
            )
            if self.found and self.found[-1].phase is span.phase:
                span = self.found.pop()._replace(end=span.end, last_ns=span.last_ns)
            self.found.append(span)
        self._ticks += len(ticks)


class RowsInMemory(Rows):
    """Rows as two arrays."""

    def __init__(self, ticks: Array, truth: Array) -> None:
        self.numbers = {TICK.topic: len(ticks), TRUTH.topic: len(truth)}
        self._part = ticks, truth

    def parts(self) -> Iterator[Part]:
        yield self._part


class FirstTicks(Rows):
    """The first ticks of other rows, with all states of the simulated rig."""

    def __init__(self, rows: Rows, ticks: int) -> None:
        self._rows = rows
        self._ticks = min(ticks, rows.numbers[TICK.topic])
        self.numbers = {**rows.numbers, TICK.topic: self._ticks}

    def parts(self) -> Iterator[Part]:
        left = self._ticks
        for ticks, truth in self._rows.parts():
            yield ticks[:left], truth
            left = max(left - len(ticks), 0)


PLACE: Final = np.dtype([(name, "<u8") for name in ("first_ns", "last_ns", "start", "size", "topics")])
"""UNIX times of a chunk's first and last message, its record's offset and size in the file, and its topics as bits."""
_BITS: Final = {topic: 1 << bit for bit, topic in enumerate((*FLAT, LOG_TOPIC, PARAMETERS_TOPIC))}


class Chunks:
    """The chunks of a file that stays as it is, read again one by one; `content` knows its channels."""

    def __init__(self, path: Path, file: BinaryIO, content: Content, places: Array) -> None:
        self.path = path
        self.content = content
        self.places = places
        """One row per chunk, of type `PLACE`."""
        self._state = _state(file)

    def has(self, topic: str) -> bool:
        """Whether a chunk has messages of that topic."""
        return _BITS.get(topic, 0) == 0 or bool((self.places["topics"] & _BITS[topic]).any())

    def unpacked(self, topics: Collection[str], places: Array | None = None) -> Iterator[bytes]:
        """Each chunk that has messages of `topics`. Raises DamagedError, and SessionError if the file has changed."""
        places = self.places if places is None else places
        wanted = places[(places["topics"] & sum(_BITS[topic] for topic in topics)) != 0]
        try:
            with opened_for_reading(self.path) as file:
                if _state(file) != self._state:
                    raise SessionError(f"{self.path}: has changed since it was opened; open it again")
                for _, _, start, size, _ in wanted.tolist():
                    file.seek(start)
                    record = file.read(size)
                    if len(record) < size or HEAD.unpack_from(record) != (Opcode.CHUNK, size - HEAD.size):
                        raise DamagedError(f"the index points to a chunk at byte {start} that is not there")
                    yield unpack_chunk(memoryview(record)[HEAD.size :], DecompressionBudget(len(record)))
        except OSError as error:
            raise SessionError(f"{self.path}: cannot be read: {error.strerror}") from error

    def messages(self, topic: str, decoded: Callable[[int, bytes], Item]) -> list[Item]:
        """The messages of a topic, `decoded` from UNIX time in ns and data. Raises SessionError."""
        try:
            return [
                decoded(*message)
                for raw in self.unpacked({topic})
                for run in self.content.runs(raw, {topic}).get(topic, ())
                for message in zip(run.rows["log_time"].tolist(), run.rows["data"].tolist(), strict=True)
            ]
        except DamagedError as error:
            raise damaged(self.path, error) from error


class StoredRows(Rows):
    """Rows in a file; each use reads what it needs of them, but few are kept from the first time on."""

    def __init__(self, chunks: Chunks, numbers: Mapping[str, int]) -> None:
        self.numbers = dict(numbers)
        self._chunks = chunks
        self._kept: Part | None = None

    def parts(self) -> Iterator[Part]:
        if (
            self._kept is None
            and sum(FLAT[topic].size * number for topic, number in self.numbers.items()) > MOST_IN_MEMORY
        ):
            return self._all()
        self._kept = self._kept or whole(self._all())
        return iter([self._kept])

    def _all(self) -> Iterator[Part]:
        left = dict(self.numbers)
        for part in self._parts(self._chunks.places):
            for topic, rows in zip(FLAT, part, strict=True):
                left[topic] -= len(rows)
            yield part
        if any(left.values()):
            error = DamagedError(f"its index counts {self.numbers}, and {left} of them are missing")
            raise damaged(self._chunks.path, error)

    def between(self, first_ns: int, end_ns: int) -> Iterator[Part]:
        places, epoch_ns = self._chunks.places, self._chunks.content.epoch_ns or 0
        within = (places["first_ns"] < epoch_ns + end_ns) & (places["last_ns"] >= epoch_ns + first_ns)
        return self._parts(places[within])

    def edges(self) -> tuple[Array, Array]:
        places = self._chunks.places[(self._chunks.places["topics"] & _BITS[TICK.topic]) != 0]
        (first, _), (last, _) = (whole(self._parts(each)) for each in (places[:1], places[-1:]))
        return first[:1], last[-1:]

    def _parts(self, places: Array) -> Iterator[Part]:
        content = self._chunks.content
        try:
            for raw in self._chunks.unpacked(FLAT, places):
                batches = content.batches(content.runs(raw, FLAT))
                for batch in batches.values():
                    _require_dates(batch.values)
                ticks, truth = (
                    batches[topic].values if topic in batches else message.array(b"") for topic, message in FLAT.items()
                )
                yield ticks, truth
        except DamagedError as error:
            raise damaged(self._chunks.path, error) from error


class GatheredRows:
    """Rows of a file that is read; too many are not kept, but only the places of their chunks."""

    def __init__(self) -> None:
        self._numbers = dict.fromkeys(FLAT, 0)
        self._places = bytearray()
        self._phases = _Phases()
        self._kept: dict[str, _Bytes] | None = {topic: _Bytes() for topic in FLAT}

    def add(self, entry: Entry, batches: Mapping[str, Batch]) -> None:
        """Add the rows of a chunk."""
        for topic, batch in batches.items():
            _require_dates(batch.values)
            self._numbers[topic] += len(batch.values)
            if self._kept is not None:
                self._kept[topic].write(batch.upgraded)
        if TICK.topic in batches:
            self._phases.add(batches[TICK.topic].values)
        topics = sum(_BITS[topic] for topic in batches)
        times_ns = fields(Opcode.CHUNK, entry.data)[:2]
        self._places += np.array((*times_ns, entry.start, entry.end - entry.start, topics), PLACE).tobytes()
        if self._kept is not None and sum(kept.size for kept in self._kept.values()) > MOST_IN_MEMORY:
            self._kept = None

    def rows(self, path: Path, file: BinaryIO, content: Content) -> Rows:
        """The rows; of more than `MOST_IN_MEMORY` bytes, to be read again from the file."""
        if self._kept is None:
            rows: Rows = StoredRows(Chunks(path, file, content, np.frombuffer(self._places, PLACE)), self._numbers)
        else:
            rows = RowsInMemory(*(message.array(self._kept[topic].contents()) for topic, message in FLAT.items()))
        rows.phases = self._phases.found
        return rows


class _Bytes:
    """Growing bytes, in an array for which numpy asks for huge pages where it is large."""

    def __init__(self) -> None:
        self.size = 0
        self._room = np.empty(0, np.uint8)

    def write(self, data: bytes, /) -> None:
        first, self.size = self.size, self.size + len(data)
        if self.size > len(self._room):
            before, self._room = self._room, np.empty(2 * self.size, np.uint8)
            self._room[:first] = before[:first]
        self._room[first : self.size] = np.frombuffer(data, np.uint8)

    def contents(self) -> memoryview:
        return self._room[: self.size].data.toreadonly()


def whole(parts: Iterable[Part]) -> Part:
    """All rows of `parts`; a copy, unless there is one part."""
    found = list(parts)
    if len(found) == 1:
        return found[0]
    none = TICK.array(b""), TRUTH.array(b"")
    ticks, truth = (joined_rows(empty, *(part[at] for part in found)) for at, empty in enumerate(none))
    return ticks, truth


def joined_rows(*rows: Array) -> Array:
    """Rows of one kind as one array, in a tenth of the time that numpy takes for columns."""
    array: Array = np.concatenate([each.view(np.uint8) for each in rows]).view(rows[0].dtype)
    return array


def in_step(parts: Iterable[Part], ticks: int = BLOCK_TICKS, truths: int = 0) -> Iterator[Part]:
    """Blocks of `ticks` ticks, each with the states up to its last tick; the last one also with all later ones.

    A file may have states behind the ticks of their time, so a block waits while fewer than `truths` states came.
    """
    waiting, held, came, first = list[Part](), 0, 0, True
    for part in parts:
        waiting.append(part)
        held, came = held + len(part[0]), came + len(part[1])
        if held <= ticks:
            continue
        rows, states = whole(waiting)
        while len(rows) > ticks:
            last_ns = rows["time_ns"][ticks - 1]
            if came < truths and not (len(states) and states["time_ns"][-1] > last_ns):
                break
            until = int(np.searchsorted(states["time_ns"], last_ns, side="right"))
            until = max(until, min(len(states), 1)) if first else until
            yield rows[:ticks], states[:until]
            rows, states, first = rows[ticks:], states[until:], False
        waiting, held = [(rows, states)], len(rows)
    rows, states = whole(waiting)
    if len(rows) or len(states):
        yield rows, states


def places(listed: Iterable[Array], content: Content) -> Array:
    """Places of chunks, from the indexes of a summary. Raises DamagedError for a channel that is not declared."""
    bits = np.zeros(1 << 16, "<u8")
    for number, (topic, _) in content.channels.items():
        bits[number] = _BITS.get(topic, 0)
    found = [np.empty(0, PLACE)]
    for indexes in listed:
        rows = np.empty(len(indexes), PLACE)
        for name in ("first_ns", "last_ns", "start", "size"):
            rows[name] = indexes[name]
        rows["topics"] = np.bitwise_or.reduce(bits[indexes["channels"]["number"]], axis=1)
        found.append(rows)
    return np.concatenate(found)


def _require_dates(rows: Array) -> None:
    """Raise DamagedError at a time above 292 years, whose differences do not fit into 64 bits."""
    latest_ns = int(rows["time_ns"].max(initial=0))
    if latest_ns > _LATEST_NS:
        raise DamagedError(f"a tick's time is {latest_ns} ns: must be at most {_LATEST_NS} ns")


def damaged(path: Path, error: DamagedError) -> SessionError:
    """What is said of a damaged file."""
    return SessionError(f"{path}: is damaged: {error}; inteco-abs recover saves the intact ticks")


def _state(file: BinaryIO) -> tuple[int, ...]:
    """What changes with the file's content, as far as that is known without reading it."""
    try:
        found = os.fstat(file.fileno())
    except OSError:  # at an address
        return (file.seek(0, os.SEEK_END),)
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns
