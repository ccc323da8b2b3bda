"""The ring's real code, with every way in which a writer's stores can fall between a reader's loads.

Loads and stores of words are taken as atomic and seen in the order in which they were made, as on x86. Wherever the
stores end, the writer may have been killed: each schedule that uses only some of them is that crash.
"""

import struct
from itertools import combinations_with_replacement

import pytest

from inteco_abs.realtime.ring import RingReader, TickRing, ring_bytes

pytestmark = pytest.mark.untraced

RECORD = struct.Struct("<QQ")
CAPACITY = 2
WORD = 8


class Recorded:
    """Memory that remembers each store as (word, value)."""

    def __init__(self, size):
        self.words, self.stores = [0] * (size // WORD), []

    def cast(self, _code):
        return self

    def __getitem__(self, at):
        return self.words[at]

    def __setitem__(self, at, value):
        self.words[at] = value
        self.stores.append((at, value))


def pack_into(memory, offset, record):
    """Word by word, as a copy of bytes is at best."""
    for i, value in enumerate(record):
        memory[offset // WORD + i] = value


def stores_of(appends, taken):
    """Stores of a writer that appends records (n, n), one slot of which `taken` has freed."""
    memory = Recorded(ring_bytes(RECORD.size, CAPACITY))
    ring = TickRing.__new__(TickRing)
    ring.memory, ring._words = memory, memory
    ring._pack, ring._capacity, ring._written = pack_into, CAPACITY, 0
    ring._size, ring._stride = RECORD.size, 2 + RECORD.size // WORD
    for number in range(appends):
        memory.words[1] = max(0, number - CAPACITY + taken)  # a reader has kept up so far
        ring.append((number + 1, number + 1))
    return memory.stores


class Scheduled:
    """Memory in which before the i-th load so many stores have been made as the schedule says."""

    def __init__(self, stores, schedule):
        self._stores, self._schedule = stores, iter(schedule)
        self._done, self.loads = 0, 0
        self.words = [0] * (ring_bytes(RECORD.size, CAPACITY) // WORD)

    def __getitem__(self, at):
        if isinstance(at, slice):
            return b"".join(self[i].to_bytes(8, "little") for i in range(at.start // WORD, at.stop // WORD))
        until = next(self._schedule, None)
        for store, value in self._stores[self._done : until]:
            self.words[store] = value
        self._done = len(self._stores) if until is None else max(self._done, until)
        self.loads += 1
        return self.words[at]

    def __setitem__(self, at, value):
        self.words[at] = value


def reader_of(memory):
    reader = RingReader.__new__(RingReader)
    reader._memory, reader._words = memory, memory
    reader._size, reader._capacity, reader._stride = RECORD.size, CAPACITY, 2 + RECORD.size // WORD
    return reader


def look(reader):
    return reader.look(0, 2)[0]


def look_later(reader):
    return reader.look(1, 2)[0]


def newest(reader):
    return reader.newest() or b""


def outcomes(read, appends):
    """Records that `read` gives under every schedule."""
    stores = stores_of(appends, taken=1)
    loads = 1 + 4 * (2 if read is not newest else 1)
    found = {}
    for schedule in combinations_with_replacement(range(len(stores) + 1), loads):
        memory = Scheduled(stores, schedule)
        reader = reader_of(memory)
        data = read(reader)
        records = tuple(RECORD.iter_unpack(data))
        found.setdefault(records, schedule)
    return found


@pytest.mark.parametrize(
    ("read", "appends"),
    [
        (newest, 4),
        (look, 2),
        (look_later, 2),
        pytest.param(look, 3, marks=pytest.mark.long),
        pytest.param(look_later, 3, marks=pytest.mark.long),
    ],
)
def test_a_record_is_complete_and_the_requested_one_or_it_is_left_out(read, appends, record_property):
    found = outcomes(read, appends)
    record_property(
        "figures", f"ring, {read.__name__}: {len(found)} outcomes of every interleaving with {appends} appends"
    )
    for records, schedule in found.items():
        assert all(one == other for one, other in records), f"torn: {records} at {schedule}"
        numbers = [one for one, _ in records]
        assert numbers == sorted(set(numbers)), schedule
        assert len(numbers) <= 2, schedule
    assert any(found), "nothing was ever read"


def test_a_ring_that_publishes_before_it_packs_would_be_found_out(monkeypatch):
    def append(self, record):
        number = self._written
        at = 8 + number % self._capacity * self._stride
        self._words[at] = self._words[at + self._stride - 1] = number + 1
        self._words[0] = self._written = number + 1
        self._pack(self.memory, WORD * (at + 1), record)

    monkeypatch.setattr(TickRing, "append", append)
    assert any(one != other for records in outcomes(newest, 3) for one, other in records)


def test_a_reader_that_looks_at_one_number_only_would_be_found_out(monkeypatch):
    def record(self, number):
        at = 8 + number % self._capacity * self._stride
        front = self._words[at]
        data = bytes(self._memory[WORD * (at + 1) : WORD * (at + 1) + self._size])
        return data if front == number + 1 else None

    monkeypatch.setattr(RingReader, "_record", record)
    assert any(one != other for records in outcomes(newest, 4) for one, other in records)
