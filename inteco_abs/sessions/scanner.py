"""Reads the records of a file, and scans one that may be damaged for intact records and damaged ranges.

After damage the scan continues at the next intact record, independent of declared lengths.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final

from inteco_abs.sessions.container import (
    HEAD,
    LARGEST_RECORD,
    LAYOUTS,
    MAGIC,
    DamagedError,
    DecompressionBudget,
    Entry,
    Opcode,
    attachment,
    fields,
    kind,
    text_map,
    unpack_chunk,
)

_BLOCK: Final = 1 << 20
_ANCHOR: Final = re.compile(rb"[\x06\x09\x0c](?=.{3}[\x00-\x03]\x00{4})", re.DOTALL)
"""Head of a chunk, attachment or metadata record of at most 64 MiB, where the scan may continue."""
_MOST_TRIALS: Final = 16
"""Bytes of wrong candidates checked per byte of file; without a bound, a hostile file would take for ever."""


@dataclass(frozen=True, slots=True)
class IntactRecord:
    """A record whose lengths and checksum are right."""

    entry: Entry
    raw: bytes | None
    """The unpacked chunk; None for other records."""
    crc: int
    """Checksum of the file before it."""


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes from `start` to before `end`, without an intact record."""

    start: int
    end: int
    problem: str
    tail: bool
    """Whether the file ends here, in the middle of a record."""


class _CutError(DamagedError):
    """The file ends before the record does, or the record's length is wrong."""


class Scan:
    """A scan of a file of `size` bytes; iterate once."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file = file
        self._size = size
        self._budget = DecompressionBudget(size)
        self._trials = LARGEST_RECORD + _MOST_TRIALS * size

    def __iter__(self) -> Iterator[IntactRecord | Damage]:
        """Records and damage in the order of the file, up to the magic at its end."""
        crc, at = 0, 0
        if self._bytes(0, len(MAGIC)) == MAGIC:
            crc, at = zlib.crc32(MAGIC), len(MAGIC)
        while at < self._size and not self._is_the_end(at):
            try:
                entry, raw = self._record(at)
            except DamagedError as error:
                damage = self._damage(at, error)
                yield damage
                crc, at = checksum(self._file, at, damage.end, crc), damage.end
            else:
                yield IntactRecord(entry, raw, crc)
                crc = zlib.crc32(entry.data, zlib.crc32(HEAD.pack(entry.opcode, len(entry.data)), crc))
                at = entry.end

    def next_intact(self, at: int) -> int | None:
        """Where the next intact chunk, attachment or metadata record begins, from `at` on; None without one."""
        for start in self._anchors(at):
            try:
                self._record(start)
            except DamagedError:
                continue
            return start
        return None

    def _record(self, at: int) -> tuple[Entry, bytes | None]:
        """The record at `at`, and the unpacked chunk if it is one. Raises DamagedError if it is not intact."""
        entry = self._entry(at)
        try:
            if entry.opcode == Opcode.CHUNK:
                return entry, unpack_chunk(entry.data, self._budget, checked=True)
            if entry.opcode in LAYOUTS:
                _check(entry)
            elif entry.opcode <= max(Opcode) or not self._is_record(entry.end):
                raise DamagedError("is not a record that can be checked")  # noqa: TRY301  gets its name below, as all others
        except DamagedError as error:
            raise DamagedError(f"{kind(entry.opcode)}: {error}") from error
        return entry, None

    def _entry(self, at: int) -> Entry:
        head = self._bytes(at, HEAD.size)
        if len(head) < HEAD.size:
            raise _CutError("the file ends in the head of a record")
        opcode, length = HEAD.unpack(head)
        if length > self._size - at - HEAD.size:
            raise _CutError(f"{kind(opcode)}: its {length} bytes leave the file")
        if length > LARGEST_RECORD:
            raise DamagedError(f"{kind(opcode)}: claims {length} bytes, more than {LARGEST_RECORD}")
        return Entry(opcode, at + HEAD.size, memoryview(self._bytes(at + HEAD.size, length)))

    def _is_record(self, at: int) -> bool:
        """Whether a known record begins at `at`; the one before it may be of a later version."""
        try:
            _check(self._entry(at))
        except DamagedError:
            return False
        return True

    def _damage(self, start: int, error: DamagedError) -> Damage:
        """The range from a damaged record to the next intact one."""
        problem = str(error)
        following = self.next_intact(start + 1)
        if following is not None:
            return Damage(start, following, problem, tail=False)
        if self._trials <= 0:
            problem += "; the search after it was given up: too many bytes there look like records"
        end = self._size - len(MAGIC)
        if start < end and self._is_the_end(end):
            return Damage(start, end, problem, tail=False)
        return Damage(start, self._size, problem, tail=isinstance(error, _CutError))

    def _anchors(self, at: int) -> Iterator[int]:
        """Places where a record with a checksum may begin, until the trials are used up."""
        while at < self._size:
            block = self._bytes(at, _BLOCK + HEAD.size - 1)
            for match in _ANCHOR.finditer(block):
                place = at + match.start()
                _, length = HEAD.unpack_from(block, match.start())
                # a record that leaves the file is refused by its head alone
                self._trials -= HEAD.size + (length if length <= self._size - place - HEAD.size else 0)
                if self._trials <= 0:
                    return
                yield place
            at += _BLOCK

    def _is_the_end(self, at: int) -> bool:
        return self._size - at == len(MAGIC) and self._bytes(at, len(MAGIC)) == MAGIC

    def _bytes(self, at: int, count: int) -> bytes:
        self._file.seek(at)
        return self._file.read(count)


class RecordFile:
    """The complete records of an open file in order; reads every byte once.

    Raises DamagedError at a record with a wrong length: one that is incomplete, although intact ones follow it.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file = file
        self._size = size
        self._crc = zlib.crc32(file.read(len(MAGIC)))
        self.crc = 0
        """Checksum of the file before the current record."""

    def __iter__(self) -> Iterator[Entry]:
        at = len(MAGIC)
        while at + HEAD.size <= self._size:
            head = self._file.read(HEAD.size)
            opcode, length = HEAD.unpack(head)
            if length > self._size - at - HEAD.size:
                self._require_cut(opcode, length, at)
                return
            if length > LARGEST_RECORD:
                raise DamagedError(f"record at byte {at} claims {length} bytes, more than {LARGEST_RECORD}")
            data = self._file.read(length)
            self.crc = self._crc
            self._crc = zlib.crc32(data, zlib.crc32(head, self._crc))
            entry = Entry(opcode, at + HEAD.size, memoryview(data))
            yield entry
            at = entry.end

    def _require_cut(self, opcode: int, length: int, at: int) -> None:
        following = Scan(self._file, self._size).next_intact(at + 1)
        if following is not None:
            problem = (
                f"claims {length} bytes, more than the file has, but intact records follow from byte {following} on"
            )
            raise DamagedError(f"{kind(opcode)} at byte {at}: {problem}")


def checksum(file: BinaryIO, start: int, end: int, crc: int = 0) -> int:
    """Checksum of the bytes from `start` to before `end`, continued from `crc`."""
    file.seek(start)
    for at in range(start, end, _BLOCK):
        crc = zlib.crc32(file.read(min(_BLOCK, end - at)), crc)
    return crc


def _check(entry: Entry) -> None:
    """Raise DamagedError unless the record's lengths and checksum are right."""
    if entry.opcode not in LAYOUTS:
        raise DamagedError("is not a record that can be checked")
    found = fields(entry.opcode, entry.data, exact=True)
    if entry.opcode == Opcode.ATTACHMENT:
        attachment(entry.data)
    elif entry.opcode in {Opcode.METADATA, Opcode.CHANNEL}:
        text_map(found[-1])
