"""The times of the ticks, as two iterators for one loop: virtual time and real time."""

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
    """The deadline of one tick."""

    deadline_ns: int
    """Time on this clock, ns."""
    skipped: int
    """Whole periods skipped since the previous beat, because its tick took too long."""


class Clock(Protocol):
    """An endless iterator of beats, with its own time."""

    def now_ns(self) -> int:
        """Return the monotonic time, ns."""
        ...

    def __iter__(self) -> Iterator[Beat]:
        """Yield each beat when its deadline comes."""
        ...


class VirtualClock:
    """A clock that starts at 0 and advances by one period with each beat, and by `pass_ns`."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._now_ns = 0
        self._deadline_ns = 0
        """Of the newest beat."""
        self._asleep_ns = 0

    def now_ns(self) -> int:
        """Return the time of the newest beat plus what has passed since, ns."""
        return self._now_ns

    def pass_ns(self, duration_ns: int) -> None:
        """Advance the clock before the next beat."""
        self._now_ns += duration_ns

    @property
    def on_time(self) -> bool:
        """Whether no time has passed since the newest beat, and the next one is on time."""
        return self._now_ns == self._deadline_ns and self._asleep_ns == 0

    def pass_beats(self, beats: int) -> None:
        """Advance by so many beats, each on time, after one on time."""
        self._deadline_ns += beats * self._period_ns
        self._now_ns = self._deadline_ns

    def oversleep_ns(self, duration_ns: int) -> None:
        """Make the next beat late by this much."""
        self._asleep_ns += duration_ns

    def __iter__(self) -> Iterator[Beat]:
        """Yield beats without waiting, at multiples of the period; deadlines that have passed are skipped."""
        period = self._period_ns
        self._deadline_ns = self._now_ns
        while True:
            deadline, now = self._deadline_ns + period, self._now_ns
            skipped = 0
            if now > deadline:
                skipped = (now - deadline) // period
                deadline += skipped * period
            self._deadline_ns = deadline
            self._now_ns = max(now, deadline) + self._asleep_ns
            self._asleep_ns = 0
            yield Beat(deadline, skipped)


class AwaitedClock:
    """A clock in real time whose beats do not wait: the board's tick paces the loop, which waits for its reports."""

    spin_ns: Final = 0

    def now_ns(self) -> int:
        """Return the system's monotonic clock, ns."""
        return time.monotonic_ns()

    def __iter__(self) -> Iterator[Beat]:
        """Yield beats at once."""
        while True:
            yield Beat(time.monotonic_ns(), 0)


class PacedClock:
    """A clock in real time, with beats at multiples of the period; periods that have passed are skipped.

    It sleeps until shortly before a deadline and spins the rest. The spin adapts: a late wake-up makes it 10 us longer,
    any other 10 ns shorter, so that about one wake-up in a thousand is late. It takes at most 40 % of a period, which
    never met the kernel's limit on real-time processes (docs/facts/real-time.md#throttling).
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._most_spin_ns = min(_MOST_SPIN_NS, int(_MOST_SPIN_SHARE * period_ns))
        self.spin_ns = min(_FIRST_SPIN_NS, self._most_spin_ns)
        """How long before a deadline it wakes up, ns."""

    def now_ns(self) -> int:
        """Return the system's monotonic clock, ns."""
        return time.monotonic_ns()

    def __iter__(self) -> Iterator[Beat]:
        """Yield each beat at its deadline."""
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
