"""Recordings of simulated rigs: what a board would have shown, and beside it what is true."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inteco_abs.rig import Plant, RigVariation
from inteco_abs.rig.plant import read_encoders

COUNTS_PER_TURN: Final = 2048
FASTEST_STEP_S: Final = 0.0005
Decide = Callable[[float, Plant], tuple[float, float]]
"""Duties of drive and brake from the time in s and the rig as it is."""
Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Recording:
    """A row per tick."""

    period_s: float
    wheel_count: Whole
    road_count: Whole
    drive: Floats
    """Duties that act from this tick on."""
    brake: Floats
    wheel_speed_rad_s: Floats
    """True, as are the next two."""
    road_speed_rad_s: Floats
    slip: Floats

    def __len__(self) -> int:
        return len(self.slip)

    def sample(self, tick: int) -> tuple[Any, ...]:
        """What an estimator gets: tick, time in ns, period in s, counts of wheel and road, duties of both motors."""
        counts = int(self.wheel_count[tick]), int(self.road_count[tick])
        duties = float(self.drive[tick]), float(self.brake[tick])
        return (tick, round(tick * self.period_s * 1e9), self.period_s, *counts, *duties)


def record(
    rig: RigVariation,
    rolling_rad_s: float,
    period_s: float,
    longest_s: float,
    decide: Decide,
    slowest_rad_s: float = 0.0,
    acts: Callable[[float, float, float], tuple[float, float]] = lambda _, *duties: duties,
) -> Recording:
    """Record a rig whose wheels roll at first, until its road is slower than `slowest_rad_s`, or for `longest_s`.

    `acts` makes the duties that act of the time and those that are decided and recorded.
    """
    k = rig.parameters
    plant = Plant(rig, k.r2 / k.r1 * rolling_rad_s, rolling_rad_s, max_step_s=max(FASTEST_STEP_S, period_s / 2.0))
    rows = list[tuple[float, ...]]()
    for tick in range(round(longest_s / period_s)):
        if plant.road_speed < slowest_rad_s:
            break
        counts = read_encoders(plant.constants, plant, tick + 1)
        duties = decide(tick * period_s, plant)
        rows.append((*counts, *duties, plant.wheel_speed, plant.road_speed, plant.slip))
        plant.advance(*acts(tick * period_s, *duties), period_s)
    wheel, road, drive, brake, x1, x2, slip = np.array(rows).T
    return Recording(period_s, wheel.astype(np.int64), road.astype(np.int64), drive, brake, x1, x2, slip)
