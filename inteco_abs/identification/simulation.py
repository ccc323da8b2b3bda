"""Simulates the counts of a segment for several sets of parameters, in machine code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from inteco_abs.identification.parameters import FULL_NM, Priors, torque_name
from inteco_abs.identification.segments import Floats, Segment, SegmentKind
from inteco_abs.machine_code import compiled
from inteco_abs.rig import DriveMotor
from inteco_abs.rig.plant import move_on
from inteco_abs.rig.state import Constants
from inteco_abs.rig_rows import rig_rows, state_rows

_STEP_S: Final[dict[SegmentKind, float]] = {"run-up": 0.001, "coast-down": 0.005, "braking": 0.001}
"""Step of the integration. From rest, 5 ms would move a count by 0.01 with the last digit of a parameter: what lowers
the sum of squares by less could not be found, and whether the search converged would depend on the processor."""
_LEAST_FADE: Final = -1.0
"""1/kJ: with the energy of both wheels, 0.5 kJ, the torque would double."""


def angles(
    segment: Segment, priors: Priors, sets: Sequence[Mapping[str, float]], speeds: Sequence[tuple[float, float]]
) -> tuple[Floats, Floats]:
    """Angles in rad of wheel and road at the compared samples, a row for each set of parameters.

    `speeds` are those of wheel and road at the first sample, rad/s, a pair for each set.
    """
    motors = [DriveMotor(values["stall"], values["no_load"]) for values in sets]
    rolling, step_s = segment.kind != "braking", _STEP_S[segment.kind]
    constants = [  # a fade below 0 is no rig's, but the search must not end in a corner at 0
        replace(
            Constants.of(priors.variation(values, rolling=rolling), motor, step_s),
            brake_fade_per_kj=max(values["fade"], _LEAST_FADE),
            adhesion_blend=blend,
            plain_curve=blend == 0.0,
        )
        for values, motor in zip(sets, motors, strict=True)
        for blend in (0.0 if rolling else values["blend"],)
    ]
    levels = (0.0, *segment.levels)
    duties = [[0.0, *(values[torque_name(level)] for level in segment.levels)] for values in sets]
    changes = int(np.count_nonzero(np.diff(segment.brake))) + 2
    due_s, torques = np.zeros((2, 1 << changes.bit_length()))  # a ring that no command can fill
    found = np.empty((2, len(sets), int(segment.compared.sum())))
    _trace(
        rig_rows(constants),
        state_rows(constants, *np.array(speeds, float).T),
        due_s,
        torques,
        np.array(duties).clip(0.0, FULL_NM) / FULL_NM,
        np.searchsorted(levels, segment.brake - 1e-9),
        segment.drive,
        np.diff(segment.time_s, append=segment.time_s[-1]),
        segment.compared,
        *found,
    )
    return found[0], found[1]


@compiled
def _trace(
    rigs: Any,
    states: Any,
    due_s: Any,
    torques: Any,
    duties: Floats,
    level: Any,
    drive: Floats,
    duration_s: Floats,
    compared: Any,
    wheel: Floats,
    road: Floats,
) -> None:
    """Write each rig's angles at the compared samples; `duties` are its own at each of the segment's levels."""
    for i in range(rigs.size):
        k, s, place = rigs[i], states[i], 0
        for tick in range(drive.size):
            if compared[tick]:
                wheel[i, place], road[i, place] = s.wheel_angle, s.road_angle
                place += 1
            move_on(k, s, due_s, torques, drive[tick], duties[i, level[tick]], duration_s[tick])
