"""The board's own timer as the clock of its samples, and as proof that an answer is no older than its request."""

from __future__ import annotations

from typing import Final

from firmware_protocol import signed32

_SECOND_NS: Final = 1_000_000_000
_LONG_AGO_NS: Final = -(1 << 62)
_DRIFT_PPM: Final = 500
"""By how much board and computer may differ: crystals keep within 100 ppm, and a timer at another rate does not."""


class BoardClock:
    """Maps readings of a free-running 32-bit timer of `hz` to the host's clock, ns.

    Every answer was made while its exchange went on, so each one bounds the difference between the two clocks from
    both sides. The bounds are kept, and widen by 500 ppm of the time that passes. A reading that contradicts them was
    made before the exchange began, or by a timer that stands still, was reset, or runs at another rate. The difference
    in force moves only where the bounds push it, so that two instants are as far apart as the board says.

    A timer wraps (after 215 s at 20 MHz); between two readings half of that may pass.
    """

    __slots__ = ("_difference_ns", "_high_ns", "_hz", "_low_ns", "_released_ns", "_seen_ns", "_tick_ns", "fault")

    def __init__(self, hz: int) -> None:
        self.fault = ""
        """What was wrong with the newest reading that was refused."""
        self._hz = hz
        self._tick_ns = -(-_SECOND_NS // hz)
        self._released_ns = _LONG_AGO_NS
        self._seen_ns = -1
        self._low_ns = self._high_ns = self._difference_ns = 0

    def restart(self, start_ns: int) -> None:
        """The timer is held at zero, and what releases it is written after `start_ns`."""
        self._released_ns, self._seen_ns = start_ns, -1

    def instant(self, reading: int, start_ns: int, end_ns: int) -> int:
        """When the timer showed `reading`, within `start_ns` and `end_ns` of its exchange; -1 if it cannot have then.

        A clock that was never restarted takes its first reading as it is.
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
