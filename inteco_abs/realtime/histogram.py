"""Histogram of lateness, 1 us a bin, in memory that a screen may read while it grows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Final

_BINS: Final = 2048
_WORD: Final = 8


class Histogram:
    """Counts lateness in bins of 1 us; the last bin holds everything from 2047 us on. Keeps the greatest value.

    `memory` has `BYTES` bytes, zero at first; only one process may add.
    """

    BYTES: ClassVar[int] = _WORD * (_BINS + 2)

    def __init__(self, memory: bytearray | memoryview | None = None) -> None:
        view = memoryview(bytearray(self.BYTES) if memory is None else memory)
        self._counts = view[: _WORD * _BINS].cast("q")
        self._greatest = view[_WORD * _BINS : _WORD * (_BINS + 1)].cast("d")
        self._skipped = view[_WORD * (_BINS + 1) : self.BYTES].cast("q")

    def add(self, values_us: Iterable[float], skipped: int = 0) -> None:
        """Count values in us, and skipped periods."""
        self._skipped[0] += skipped
        counts, greatest = self._counts, self._greatest[0]
        for value in values_us:
            counts[min(max(int(value), 0), _BINS - 1)] += 1
            greatest = max(greatest, value)
        self._greatest[0] = greatest

    def clear(self) -> None:
        """Reset all counts to zero."""
        for at in range(_BINS):
            self._counts[at] = 0
        self._greatest[0], self._skipped[0] = 0.0, 0

    @property
    def skipped(self) -> int:
        """Periods skipped so far."""
        return self._skipped[0]

    @property
    def greatest_us(self) -> float:
        """Greatest value so far, us."""
        return self._greatest[0]

    def quantiles_us(self, shares: Iterable[float]) -> list[float | None]:
        """Return the upper bin edge for each share, ascending in 0..1, of the values, us; None without values."""
        counts = self._counts.tolist()
        total, seen, at, found = sum(counts), 0, -1, list[float | None]()
        for share in shares:
            while total and seen < share * total and at < _BINS - 1:
                at += 1
                seen += counts[at]
            found.append(min(at + 1.0, self.greatest_us) if total else None)
        return found

    def sparse(self) -> dict[str, int]:
        """Return the counts by lower edge of the bin in us, without empty bins."""
        return {str(at): count for at, count in enumerate(self._counts.tolist()) if count}
