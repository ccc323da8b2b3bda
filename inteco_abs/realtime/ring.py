"""Preallocated memory for the records of one experiment."""

from __future__ import annotations

from collections.abc import Callable

from inteco_abs.signals import Tick

Pack = Callable[[bytearray, int, Tick], None]
"""Writes one tick's record into a buffer at an offset."""


class TickRing:
    """Fixed-size records, `capacity` of them, packed by the loop and read by whoever records.

    Memory is touched once here, so that the loop meets no page fault. Readers call `take` and may do so while the
    loop is between two ticks.
    """

    def __init__(self, pack: Pack, record_bytes: int, capacity: int) -> None:
        self._pack = pack
        self._size = record_bytes
        self._capacity = capacity
        self._buffer = bytearray(record_bytes * capacity)
        self._written = 0
        self._taken = 0

    @property
    def written(self) -> int:
        """Number of records appended so far."""
        return self._written

    def append(self, tick: Tick) -> None:
        """Pack one tick. Raises BufferError rather than overwrite a record that nobody has taken."""
        if self._written - self._taken >= self._capacity:
            raise BufferError(f"the ring is full: {self._capacity} records and nobody takes them")
        self._pack(self._buffer, self._written % self._capacity * self._size, tick)
        self._written += 1

    def take(self) -> bytes:
        """Records that were not taken yet, oldest first, back to back."""
        first, end = self._taken % self._capacity, self._written % self._capacity
        if self._written == self._taken:
            return b""
        self._taken = self._written
        if first < end:
            return bytes(self._buffer[first * self._size : end * self._size])
        return bytes(self._buffer[first * self._size :] + self._buffer[: end * self._size])
