"""Simulates the counts of a segment for several sets of parameters at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from inteco_abs.identification.parameters import FULL_NM, Priors, torque_name
from inteco_abs.identification.segments import Floats, Segment, SegmentKind
from inteco_abs.montecarlo import BatchPlant
from inteco_abs.rig import DriveMotor

_STEP_S: Final[dict[SegmentKind, float]] = {"run-up": 0.005, "coast-down": 0.005, "braking": 0.001}
"""Step of the integration."""


def angles(
    segment: Segment, priors: Priors, sets: Sequence[Mapping[str, float]], speeds: Sequence[tuple[float, float]]
) -> tuple[Floats, Floats]:
    """Angles in rad of wheel and road at the compared samples, a row for each set of parameters.

    `speeds` are those of wheel and road at the first sample, rad/s, a pair for each set.
    """
    wheel_speed, road_speed = np.array(speeds, float).T
    plant = BatchPlant(
        [priors.variation(values) for values in sets],
        road_speed,
        wheel_speed,
        [DriveMotor(values["stall"], values["no_load"]) for values in sets],
        max_step_s=_STEP_S[segment.kind],
    )
    levels = {0.0: np.zeros(len(sets))}
    for duty in segment.levels:
        levels[duty] = np.array([values[torque_name(duty)] for values in sets]).clip(0.0, FULL_NM) / FULL_NM
    brakes = [levels[round(duty, 4)] for duty in segment.brake.tolist()]
    found = np.empty((2, int(segment.compared.sum()), len(sets)))
    durations, place = np.diff(segment.time_s, append=segment.time_s[-1]).tolist(), 0
    ticks = zip(segment.compared.tolist(), segment.drive.tolist(), brakes, durations, strict=True)
    for compared, drive, brake, duration_s in ticks:
        if compared:
            found[0, place], found[1, place] = plant.wheel_angle, plant.road_angle
            place += 1
        plant.advance(drive, brake, duration_s)
    return found[0].T, found[1].T
