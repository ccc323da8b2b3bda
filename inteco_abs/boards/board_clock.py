"""Dates samples by the board's timer, and proves that an answer is not older than its request."""

from __future__ import annotations

from typing import Final

from firmware_protocol import signed32

_SECOND_NS: Final = 1_000_000_000
_LONG_AGO_NS: Final = -(1 << 62)
_DRIFT_PPM: Final = 500
"""Allowed drift between board and computer: crystals stay within 100 ppm; a timer at another rate does not."""


class BoardClock:
    """Maps readings of a free-running 32-bit timer of `hz` to the host's clock, ns.

    The board makes each answer during its exchange, so each one bounds the difference between the two clocks from both
    sides. The bounds widen by 500 ppm of the time that passes. A reading outside them was made before the exchange, or
    by a timer that stands still, was reset, or runs at another rate. The difference moves only where a bound pushes it,
    so that two instants are as far apart as the board says.

    The timer wraps (after 215 s at 20 MHz); at most half of that may pass between two readings.
    """

    __slots__ = ("_difference_ns", "_high_ns", "_hz", "_low_ns", "_released_ns", "_seen_ns", "_tick_ns", "fault")

    def __init__(self, hz: int) -> None:
        self.fault = ""
        """Why the last refused reading was wrong."""
        self._hz = hz
        self._tick_ns = -(-_SECOND_NS // hz)
        self._released_ns = _LONG_AGO_NS
        self._seen_ns = -1
        self._low_ns = self._high_ns = self._difference_ns = 0

    def restart(self, start_ns: int) -> None:
        """Note that the timer is held at zero, and will be released after `start_ns`."""
        self._released_ns, self._seen_ns = start_ns, -1

    def instant(self, reading: int, start_ns: int, end_ns: int) -> int:
        """Return when the timer showed `reading`, in `start_ns`..`end_ns` of its exchange; -1 if that is impossible.

        A clock that was never restarted accepts its first reading.
        """
        tick_ns = self._tick_ns
        if self._seen_ns < 0:
            board_ns = reading * _SECOND_NS // self._hz
            low, high = self._released_ns - tick_ns, end_ns - board_ns
            self._difference_ns = high
        else:
            expected = (end_ns - self._difference_ns) * self._hz // _SECOND_NS
            ticks = expected + signed32(reading - expected)
            board_ns = ticks * _SECOND_NS // self._hz
            slack = (end_ns - self._seen_ns) * _DRIFT_PPM // 1_000_000
            low, high = self._low_ns - slack, self._high_ns + slack
        least, most = start_ns - board_ns - tick_ns, end_ns - board_ns
        if least > high or most < low:
            self.fault = _fault(least - high, low - most)
            return -1
        low, high = max(low, least), min(high, most)
        self._low_ns, self._high_ns, self._seen_ns = low, high, end_ns
        difference = self._difference_ns = min(max(self._difference_ns, low), high)
        return min(max(board_ns + difference, start_ns), end_ns)


def _fault(early_ns: int, late_ns: int) -> str:
    if early_ns > 0:
        return (
            f"by the board's timer the answer is {early_ns * 1e-3:.0f} us older than its request: an answer to an "
            "older one, or a timer that stands still, was reset, or is slower than the profile says"
        )
    return (
        f"by the board's timer the answer was made {late_ns * 1e-3:.0f} us after it arrived: the timer was reset, or "
        "is faster than the profile says"
    )
