"""Memory for the records of one experiment, shared without a lock between one writer and its readers.

A slot holds the record between two copies of its number, the first written before and the second after it, so that
a reader tells a torn or overwritten record from a whole one. The writer makes no system call and waits for nobody;
readers poll.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable
from typing import Any, Final

_WORD: Final = 8
_HEAD_WORDS: Final = 8
"""Counters before the slots, with a cache line of their own."""
_WRITTEN, _TAKEN = 0, 1

Pack = Callable[[Any, int, Any], None]
"""Writes one record into a buffer at an offset."""


def ring_bytes(record_bytes: int, capacity: int) -> int:
    """Size of the memory of a ring, a multiple of 8 bytes."""
    return _WORD * (_HEAD_WORDS + capacity * _slot_words(record_bytes))


def _slot_words(record_bytes: int) -> int:
    return 2 + -(-record_bytes // _WORD)


class TickRing:
    """The writer's end: `capacity` records of `record_bytes`, packed by `pack`.

    `memory` is writable and zero, of `ring_bytes(record_bytes, capacity)`; by default the ring makes its own. The
    first record has the number `first`: those before it are elsewhere.
    """

    def __init__(
        self, pack: Pack, record_bytes: int, capacity: int, memory: bytearray | memoryview | None = None, first: int = 0
    ) -> None:
        self.memory = memoryview(mmap.mmap(-1, ring_bytes(record_bytes, capacity)) if memory is None else memory)
        self._pack = pack
        self._capacity = capacity
        self._stride = _slot_words(record_bytes)
        self._words = self.memory.cast("Q")
        self._size = record_bytes
        self._written = first
        if first:
            self._words[_WRITTEN] = self._words[_TAKEN] = first

    @property
    def written(self) -> int:
        """Number of the next record."""
        return self._written

    def reader(self) -> RingReader:
        """A reader's end in the same process."""
        return RingReader(self.memory, self._size, self._capacity)

    def append(self, record: Any) -> None:
        """Pack one record. Raises BufferError rather than overwrite one that was not taken."""
        words, number = self._words, self._written
        if number - words[_TAKEN] >= self._capacity:
            raise BufferError(f"the ring is full: {self._capacity} records and nobody takes them")
        at = _HEAD_WORDS + number % self._capacity * self._stride
        number += 1
        words[at] = number
        self._pack(self.memory, _WORD * (at + 1), record)
        words[at + self._stride - 1] = number
        words[_WRITTEN] = self._written = number


class RingReader:
    """A reader's end. The one that `take`s tells the writer so; any number may look at the `newest`."""

    def __init__(self, memory: bytearray | memoryview, record_bytes: int, capacity: int) -> None:
        self.lost = 0
        """Records that were torn or overwritten before they were taken."""
        self._memory = memoryview(memory)
        self._words = self._memory.cast("Q")
        self._size = record_bytes
        self._capacity = capacity
        self._stride = _slot_words(record_bytes)

    @property
    def written(self) -> int:
        """Number of records published so far."""
        return self._words[_WRITTEN]

    @property
    def taken(self) -> int:
        """Number of records taken so far, lost ones included."""
        return self._words[_TAKEN]

    @property
    def room(self) -> int:
        """Records that the writer can still append before it would have to overwrite one that was not taken."""
        return self._capacity - (self.written - self.taken)

    def held_from(self, spare: float = 0.0) -> int:
        """Number of the oldest record that the ring still holds, from 0.

        With a `spare` share of the capacity, of the oldest that it still holds once the writer, which goes on, has
        filled that.
        """
        return max(0, min(self.taken, self.written - round((1.0 - spare) * self._capacity)))

    def rewind(self) -> int:
        """Go back to the oldest record that the ring still holds; its number."""
        oldest = self.held_from()
        self.release(oldest)
        return oldest

    def take(self, most: int | None = None) -> bytes:
        """Up to `most` records that were not taken yet, oldest first, back to back."""
        records, end = self.look(self.taken, most)
        self.release(end)
        return records

    def look(self, first: int, most: int | None = None) -> tuple[bytes, int]:
        """Up to `most` records from number `first` on, without taking any; and the number of the next one."""
        end = self.written if most is None else min(self.written, first + most)
        records = [self._record(number) for number in range(first, end)]
        whole = [record for record in records if record is not None]
        self.lost += len(records) - len(whole)
        return b"".join(whole), end

    def sample(self, first: int, step: int) -> tuple[bytes, int]:
        """Every `step`-th record from number `first` on, without taking any; and the number of the next one.

        For a screen: what is gone by now is left out, and not counted as lost.
        """
        behind = max(0, self.written - self._capacity - first)
        numbers = range(first + -(-behind // step) * step, self.written, step)
        records = (self._record(number) for number in numbers)
        return b"".join(record for record in records if record is not None), numbers.start + len(numbers) * step

    def release(self, end: int) -> None:
        """Take what was looked at, up to number `end`: the writer may overwrite it."""
        self._words[_TAKEN] = end

    def newest(self) -> bytes | None:
        """The newest record: a snapshot, for a screen. None if there is none, or it was just being overwritten."""
        written = self.written
        return self._record(written - 1) if written else None

    def _record(self, number: int) -> bytes | None:
        at = _HEAD_WORDS + number % self._capacity * self._stride
        # against the writer's order, so that an overwrite that begins meanwhile is seen too
        back = self._words[at + self._stride - 1]
        record = bytes(self._memory[_WORD * (at + 1) : _WORD * (at + 1) + self._size])
        front = self._words[at]
        return record if front == back == number + 1 else None
