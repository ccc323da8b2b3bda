"""Where over a range of road speeds something does not hold."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.gain_design.bounds import Floats

_HALVINGS: Final = 30


class Interval(NamedTuple):
    """Road speeds, rad/s."""

    low: float
    high: float


def where_lost(margin: Callable[[Floats], Floats], speeds: Floats) -> list[Interval]:
    """Where `margin` is not above 0, found at rising `speeds` and made exact between two of them."""

    def edge(lost: float, kept: float) -> float:
        for _ in range(_HALVINGS):
            middle = 0.5 * (lost + kept)
            if margin(np.array([middle]))[0] > 0.0:
                kept = middle
            else:
                lost = middle
        return lost

    found = []
    for holds, run in groupby(enumerate(margin(speeds) > 0.0), key=lambda one: bool(one[1])):
        if not holds:
            first, *rest = (index for index, _ in run)
            last = rest[-1] if rest else first
            low = edge(speeds[first], speeds[first - 1]) if first > 0 else speeds[first]
            high = edge(speeds[last], speeds[last + 1]) if last + 1 < len(speeds) else speeds[last]
            found.append(Interval(float(low), float(high)))
    return found


def in_words(intervals: list[Interval], speeds: Floats) -> str:
    """Such as "below 71.3 rad/s"."""

    def one(interval: Interval) -> str:
        from_start, to_end = interval.low <= speeds[0], interval.high >= speeds[-1]
        if from_start and to_end:
            return "at every speed"
        if from_start:
            return f"below {interval.high:.1f} rad/s"
        if to_end:
            return f"above {interval.low:.1f} rad/s"
        return f"from {interval.low:.1f} to {interval.high:.1f} rad/s"

    return " and ".join(map(one, intervals))
