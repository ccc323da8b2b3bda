"""When the ticks are: two iterators under one loop, in virtual time and in real time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Final, NamedTuple, Protocol

_FIRST_SPIN_NS: Final = 120_000
_LEAST_SPIN_NS: Final = 20_000
_MOST_SPIN_NS: Final = 150_000
_MOST_SPIN_SHARE: Final = 0.4
_SPIN_LONGER_NS: Final = 10_000
_SPIN_SHORTER_NS: Final = 10


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
    """Time that moves on by one period with each beat, and when told to. Starts at 0."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._now_ns = 0
        self._asleep_ns = 0

    def now_ns(self) -> int:
        """Time of the newest beat and what has passed since, ns."""
        return self._now_ns

    def pass_ns(self, duration_ns: int) -> None:
        """Let time pass before the next beat."""
        self._now_ns += duration_ns

    def oversleep_ns(self, duration_ns: int) -> None:
        """Make the next beat so much late."""
        self._asleep_ns += duration_ns

    def __iter__(self) -> Iterator[Beat]:
        """Beats without waiting, at multiples of the period; those that have passed are left out."""
        period = self._period_ns
        deadline = self._now_ns
        while True:
            deadline += period
            now = self._now_ns
            skipped = 0
            if now > deadline:
                skipped = (now - deadline) // period
                deadline += skipped * period
            self._now_ns = max(now, deadline) + self._asleep_ns
            self._asleep_ns = 0
            yield Beat(deadline, skipped)


class PacedClock:
    """Beats in real time, at multiples of the period from the first. Periods that have passed are left out.

    Sleeps until shortly before a deadline and spins the rest. How long it spins follows how late this machine wakes
    up: a wake-up past its deadline makes the spin longer at once, all others make it a little shorter, so that about
    one wake-up in a thousand is late. Never more than 40 % of a period: that much spinning never met the kernel's
    limit on real-time processes (docs/facts/real-time.md#throttling).
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._most_spin_ns = min(_MOST_SPIN_NS, int(_MOST_SPIN_SHARE * period_ns))
        self.spin_ns = min(_FIRST_SPIN_NS, self._most_spin_ns)
        """How long before a deadline it wakes up now."""

    def now_ns(self) -> int:
        """The system's monotonic clock, ns."""
        return time.monotonic_ns()

    def __iter__(self) -> Iterator[Beat]:
        """Beats, each at its deadline."""
        now, sleep, period = time.monotonic_ns, time.sleep, self._period_ns
        deadline = now()
        while True:
            deadline += period
            left = deadline - now()
            skipped = 0
            if left > 0:
                if left > self.spin_ns:
                    sleep((left - self.spin_ns) * 1e-9)
                    self._adapt(now() > deadline)
                while now() < deadline:
                    pass
            else:
                skipped = -left // period
                deadline += skipped * period
            yield Beat(deadline, skipped)

    def _adapt(self, late: bool) -> None:
        if late:
            self.spin_ns = min(self.spin_ns + _SPIN_LONGER_NS, self._most_spin_ns)
        elif self.spin_ns > _LEAST_SPIN_NS:
            self.spin_ns -= _SPIN_SHORTER_NS
