"""Speed from quadrature counts over a window of samples, in rad/s."""

from __future__ import annotations

import math
from collections import deque


class MovingAverageSpeed:
    """Mean speed over the last `length` samples, (count - earlier count) * 2 pi / (N * elapsed time).

    With length 1 it is the paper's Euler formula. Until the window is full, the samples so far are used.
    """

    __slots__ = ("_angle_ns", "_samples")

    def __init__(self, counts_per_turn: int, length: int) -> None:
        self._angle_ns = 2.0 * math.pi / counts_per_turn * 1e9
        self._samples: deque[tuple[int, int]] = deque(maxlen=length)

    def clear(self) -> None:
        self._samples.clear()

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s at the sample taken at `time_ns`; 0 at the first sample."""
        samples = self._samples
        then, before = samples[0] if samples else (time_ns, count)
        samples.append((time_ns, count))
        return (count - before) * self._angle_ns / (time_ns - then) if time_ns > then else 0.0


class MovingAverageSpeeds:
    """A `MovingAverageSpeed` of both wheels, bit for bit, which keeps their common times once."""

    __slots__ = ("_angle_ns", "_samples")

    def __init__(self, counts_per_turn: int, length: int) -> None:
        self._angle_ns = 2.0 * math.pi / counts_per_turn * 1e9
        self._samples: deque[tuple[int, int, int]] = deque(maxlen=length)

    def update(self, time_ns: int, wheel_count: int, road_count: int) -> tuple[float, float]:
        """Speeds of wheel and road in rad/s at the sample taken at `time_ns`; 0 at the first sample."""
        samples = self._samples
        then, wheel, road = samples[0] if samples else (time_ns, wheel_count, road_count)
        samples.append((time_ns, wheel_count, road_count))
        elapsed_ns = time_ns - then
        if elapsed_ns <= 0:
            return 0.0, 0.0
        angle_ns = self._angle_ns
        return (wheel_count - wheel) * angle_ns / elapsed_ns, (road_count - road) * angle_ns / elapsed_ns
