"""Memory for the records of one experiment, shared without a lock between one writer and its readers.

A slot holds the record between two copies of its number, the first written before it and the second after it, so that
a reader detects a torn or overwritten record. The writer makes no system call and never waits; readers poll.
"""

from __future__ import annotations

import mmap
import sys
from collections.abc import Callable
from typing import Any, Final

_WORD: Final = 8
_HEAD_WORDS: Final = 8
"""Counters before the slots, in their own cache line."""
_WRITTEN, _TAKEN = 0, 1
_MANY: Final = 64
"""Records that numpy copies faster than a loop does, if it is loaded already: a screen has none, and looks at few."""

Pack = Callable[[Any, int, Any], None]
"""Writes one record into a buffer at an offset."""


def ring_bytes(record_bytes: int, capacity: int) -> int:
    """Return the memory size of a ring in bytes, a multiple of 8."""
    return _WORD * (_HEAD_WORDS + capacity * _slot_words(record_bytes))


def _slot_words(record_bytes: int) -> int:
    return 2 + -(-record_bytes // _WORD)


class TickRing:
    """The writer's end: `capacity` records of `record_bytes`, packed by `pack`.

    `memory` is writable and zero, of `ring_bytes(record_bytes, capacity)` bytes; by default the ring allocates it. The
    first record has the number `first`.
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
        """Return a reader in the same process."""
        return RingReader(self.memory, self._size, self._capacity)

    def append(self, record: Any) -> None:
        """Pack one record. Raises BufferError rather than overwrite a record that was not taken."""
        words, number = self._words, self._written
        if number - words[_TAKEN] >= self._capacity:
            raise BufferError(f"the ring is full: {self._capacity} records wait to be taken")
        at = _HEAD_WORDS + number % self._capacity * self._stride
        number += 1
        words[at] = number
        self._pack(self.memory, _WORD * (at + 1), record)
        words[at + self._stride - 1] = number
        words[_WRITTEN] = self._written = number

    def extend(self, records: bytes) -> None:
        """Append packed records, which lie back to back. Raises BufferError as `append`, before it appends any.

        It loads numpy, and needs much less time than `append` for a thousand records.
        """
        import numpy as np  # noqa: PLC0415  the loop's process in real time does without

        words, size, first = self._words, self._size, self._written
        data = np.frombuffer(records, np.uint8).reshape(-1, size)
        end = first + len(data)
        if end - words[_TAKEN] > self._capacity:
            raise BufferError(f"the ring is full: {first - words[_TAKEN]} records wait to be taken")
        numbers = np.arange(first, end)
        slots = np.frombuffer(self.memory, np.uint64)[_HEAD_WORDS:][: self._capacity * self._stride]
        slots, places = slots.reshape(self._capacity, self._stride), numbers % self._capacity
        slots[places, 0] = numbers + 1
        slots.view(np.uint8)[places, _WORD : _WORD + size] = data
        slots[places, -1] = numbers + 1
        words[_WRITTEN] = self._written = end


class RingReader:
    """The reader's end. One reader may `take` records; any number may `look` at them."""

    def __init__(self, memory: bytearray | memoryview, record_bytes: int, capacity: int) -> None:
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
        """Number of records taken so far."""
        return self._words[_TAKEN]

    @property
    def room(self) -> int:
        """Number of records that the writer can append before the ring is full."""
        return self._capacity - (self.written - self.taken)

    def held_from(self, spare: float = 0.0) -> int:
        """Return the number of the oldest record that the ring holds, from 0.

        `spare` is the share of the capacity that the writer may fill before the record is read.
        """
        return max(0, min(self.taken, self.written - round((1.0 - spare) * self._capacity)))

    def take(self, most: int | None = None) -> bytes:
        """Take up to `most` records, oldest first, and return them back to back."""
        records, end = self.look(self.taken, most)
        self.release(end)
        return records

    def look(self, first: int, most: int | None = None) -> tuple[bytes, int]:
        """Return up to `most` whole records from number `first` on, and the number of the next; takes none."""
        end = self.written if most is None else min(self.written, first + most)
        if end - first >= _MANY and "numpy" in sys.modules:
            return self._many(first, end), end
        records = (self._record(number) for number in range(first, end))
        return b"".join(record for record in records if record is not None), end

    def sample(self, first: int, step: int) -> tuple[bytes, int]:
        """Return every `step`-th record from number `first` on that the ring holds, and the number of the next."""
        behind = max(0, self.written - self._capacity - first)
        numbers = range(first + -(-behind // step) * step, self.written, step)
        records = (self._record(number) for number in numbers)
        return b"".join(record for record in records if record is not None), numbers.start + len(numbers) * step

    def release(self, end: int) -> None:
        """Let the writer overwrite all records before number `end`."""
        self._words[_TAKEN] = end

    def newest(self) -> bytes | None:
        """Return the newest record; None if there is none, or it is just being overwritten."""
        written = self.written
        return self._record(written - 1) if written else None

    def _many(self, first: int, end: int) -> bytes:
        """Return whole records as `_record` does, by numpy."""
        import numpy as np  # noqa: PLC0415  it is loaded

        numbers = np.arange(first, end)
        slots = np.frombuffer(self._memory, np.uint64)[_HEAD_WORDS:][: self._capacity * self._stride]
        slots, places = slots.reshape(self._capacity, self._stride), numbers % self._capacity
        back = slots[places, -1]
        records = slots.view(np.uint8)[places, _WORD : _WORD + self._size]
        front = slots[places, 0]
        whole = (front == back) & (front == (numbers + 1).astype(np.uint64))
        return records.tobytes() if whole.all() else records[whole].tobytes()

    def _record(self, number: int) -> bytes | None:
        at = _HEAD_WORDS + number % self._capacity * self._stride
        # in the opposite order of the writer, which detects an overwrite that begins meanwhile
        back = self._words[at + self._stride - 1]
        record = bytes(self._memory[_WORD * (at + 1) : _WORD * (at + 1) + self._size])
        front = self._words[at]
        return record if front == back == number + 1 else None
