"""Angle of a wheel since the first sample, from its count."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(slots=True)
class CountState:
    """State of an encoder whose first count is the angle 0."""

    origin: int = 0
    before_ns: int = -1
    """Time of the sample before; -1 before the first one."""


def rad_per_count(counts_per_turn: int) -> float:
    """Angle of one count in rad."""
    return 2.0 * math.pi / counts_per_turn


def turned(per_count: float, s: CountState, time_ns: int, count: int) -> tuple[float, float]:
    """Angle in rad, and the time in s since the sample before; both 0 at the first sample."""
    if s.before_ns < 0:
        s.origin, s.before_ns = count, time_ns
    elapsed_s = (time_ns - s.before_ns) * 1e-9
    s.before_ns = time_ns
    return (count - s.origin) * per_count, elapsed_s
