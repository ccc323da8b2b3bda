"""Speed from quadrature counts over a window of samples: the one place where counts become rad/s."""

from __future__ import annotations

import math


class SpeedWindow:
    """Mean speed over the last `length` samples, (count - earlier count) * 2 pi / (N * elapsed time).

    With length 1 it is the paper's Euler formula. Until the window is full, the samples so far are used.
    """

    __slots__ = ("_angle_ns", "_counts", "_filled", "_length", "_next", "_times")

    def __init__(self, counts_per_turn: int, length: int) -> None:
        self._angle_ns = 2.0 * math.pi / counts_per_turn * 1e9
        self._length = length
        self._times = [0] * length
        self._counts = [0] * length
        self._next = 0
        self._filled = 0

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s at the sample taken at `time_ns`; 0 at the first sample."""
        at = self._next
        if self._filled == self._length:
            then, before = self._times[at], self._counts[at]
        else:
            then, before = (self._times[0], self._counts[0]) if self._filled else (time_ns, count)
            self._filled += 1
        self._times[at] = time_ns
        self._counts[at] = count
        self._next = at + 1 if at + 1 < self._length else 0
        elapsed = time_ns - then
        return (count - before) * self._angle_ns / elapsed if elapsed > 0 else 0.0
