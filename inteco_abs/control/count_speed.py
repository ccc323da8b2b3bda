"""Speed from quadrature counts over a window of samples, in rad/s."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from inteco_abs.control.functions import Function


@dataclass(frozen=True, slots=True)
class WindowConstants:
    """Constants of a window over the samples of one or two encoders."""

    angle_ns: float
    """Angle of one count, times 1e9: speeds come from times in ns."""
    length: int
    """Samples that the window holds."""


def window_constants(counts_per_turn: int, length: int) -> WindowConstants:
    """Constants of a window of `length` samples, at least 1."""
    return WindowConstants(2.0 * math.pi / counts_per_turn * 1e9, length)


@dataclass(slots=True)
class Window:
    """The newest samples of two encoders, as rings."""

    times_ns: list[int]
    wheel_counts: list[int]
    road_counts: list[int]
    oldest: int = -1
    """Place of the oldest sample, which the next one replaces; -1 before the first one, which fills the rings."""


def empty_window(length: int) -> Window:
    """A window that has seen no sample."""
    return Window(*_rings(length))


def _rings(length: int) -> tuple[list[int], list[int], list[int]]:
    ring = [0] * length
    return ring, ring.copy(), ring.copy()


def mean_speeds(k: WindowConstants, s: Window, time_ns: int, wheel_count: int, road_count: int) -> tuple[float, float]:
    """Mean speeds of both wheels in rad/s over the last `k.length` samples, of which this is the newest.

    They are (count - earlier count) * 2 pi / (N * elapsed time); with length 1, the paper's Euler formula. Until the
    window is full the samples so far are used; 0 at the first sample.
    """
    times_ns, wheel_counts, road_counts, i = s.times_ns, s.wheel_counts, s.road_counts, s.oldest
    if i < 0:
        for j in range(k.length):
            times_ns[j], wheel_counts[j], road_counts[j] = time_ns, wheel_count, road_count
        i = 0
    elapsed_ns = time_ns - times_ns[i]
    wheel = wheel_count - wheel_counts[i]
    road = road_count - road_counts[i]
    times_ns[i] = time_ns
    wheel_counts[i] = wheel_count
    road_counts[i] = road_count
    i += 1
    s.oldest = i if i < k.length else 0
    if elapsed_ns <= 0:
        return 0.0, 0.0
    angle_ns = k.angle_ns
    return wheel * angle_ns / elapsed_ns, road * angle_ns / elapsed_ns


def mean_speed(k: WindowConstants, s: Window, time_ns: int, count: int) -> float:
    """Return the mean speed of one encoder, as `mean_speeds` does of two."""
    return mean_speeds(k, s, time_ns, 0, count)[1]


class MovingAverageSpeed(Window):
    """Mean speed over the last `length` samples, as by `mean_speeds`."""

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(mean_speed)

    def __init__(self, counts_per_turn: int, length: int) -> None:
        super().__init__(*_rings(length))
        self.k = window_constants(counts_per_turn, length)

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s at the sample taken at `time_ns`; 0 at the first sample."""
        return mean_speed(self.k, self, time_ns, count)
