"""When the ticks are: two iterators under one loop, in virtual time and in real time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import NamedTuple, Protocol


class Beat(NamedTuple):
    """One tick's place in time."""

    deadline_ns: int
    """On the clock's own time."""
    skipped: int
    """Whole periods left out since the beat before, because it took too long."""


class Clock(Protocol):
    """Endless beats, and the time they are measured in."""

    def now_ns(self) -> int:
        """Monotonic time, ns."""
        ...

    def __iter__(self) -> Iterator[Beat]:
        """Beats, each given out when its time has come."""
        ...


class VirtualClock:
    """Time that moves on by one period with each beat, and only then. Starts at 0."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._now_ns = 0

    def now_ns(self) -> int:
        """Time of the newest beat, ns."""
        return self._now_ns

    def __iter__(self) -> Iterator[Beat]:
        """Beats without waiting."""
        while True:
            self._now_ns += self._period_ns
            yield Beat(self._now_ns, 0)


class PacedClock:
    """Beats in real time, at multiples of the period from the first. Periods that have passed are left out."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns

    def now_ns(self) -> int:
        """The system's monotonic clock, ns."""
        return time.monotonic_ns()

    def __iter__(self) -> Iterator[Beat]:
        """Beats, each after a sleep to its deadline."""
        period, deadline = self._period_ns, time.monotonic_ns()
        while True:
            deadline += period
            left = deadline - time.monotonic_ns()
            skipped = 0
            if left > 0:
                time.sleep(left * 1e-9)
            else:
                skipped = -left // period
                deadline += skipped * period
            yield Beat(deadline, skipped)
