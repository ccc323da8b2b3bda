"""Grades an identification: recordings of each rig without its truth, judged by values and intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from inteco_abs.course.exercise import Exercise
from inteco_abs.course.measured import Draw, Measured, median
from inteco_abs.course.recordings import COUNTS_PER_TURN, Decide, Recording, record
from inteco_abs.course.submission import Submission, SubmissionError
from inteco_abs.rig import RigVariation, settled_torque

DUTY: Final = 0.6
"""Duty at which the brake's torque is asked for."""
_COAST_PERIOD_S: Final = 0.01
_COAST_S: Final = 30.0
_BRAKE_PERIOD_S: Final = 0.001
_BRAKE_S: Final = 0.9
_BRAKING_FROM_S: Final = 0.1
_SLOWEST_RAD_S: Final = 10.0
_WIDTHS: Final = {"r1/r2": 0.08, "d/J": 0.0045, "M0/J": 0.26, "B": 50.0, "lag": 0.05, "dead time": 0.026}
"""Width of each parameter's range among the rigs of the exercise."""
_OUTSIDE: Final = 2.0 / 0.05
"""Weight of the distance from a truth outside of an interval of 95 %."""


def identify(exercise: Exercise, submission: Submission, draw: Draw) -> Measured:
    """The recordings of each rig. Raises SubmissionError."""
    rigs, numbers = draw.rigs(), draw.numbers("recordings")
    rows = list[dict[str, float]]()
    for rig in rigs.values():
        rolling = numbers.uniform(150.0, 175.0), numbers.uniform(140.0, 170.0)
        given = submission.ask("identify", COUNTS_PER_TURN, _sessions(rig, *rolling))
        rows.append(_judged(_checked(given), truth(rig)))
    values = {limit.measure: [row[limit.measure] for row in rows] for limit in exercise.limits}
    zero, hundred = float(exercise.score.zero), float(exercise.score.hundred)  # type: ignore[arg-type]
    return Measured(tuple(rigs), values, median(values[exercise.score.measure]), zero, hundred)


def truth(rig: RigVariation) -> dict[str, float]:
    """The parameters asked for, of a rig: of both wheels as they roll, in terms of the road's."""
    k, ratio = rig.parameters, rig.parameters.r2 / rig.parameters.r1
    inertia = k.J2 + ratio * ratio * k.J1
    return {
        "r1/r2": 1.0 / ratio,
        "d/J": (k.d2 + ratio * ratio * k.d1) / inertia,
        "M0/J": (k.M20 + ratio * k.M10) / inertia,
        "B": ratio * settled_torque(DUTY, rig) / inertia,
        "lag": 1.0 / k.c31,
        "dead time": rig.brake_dead_time_s,
    }


def _sessions(rig: RigVariation, coasting_rad_s: float, braking_rad_s: float) -> list[dict[str, Any]]:
    """A coast-down, and steps of the brake to 0.55, 0.6 and 0.65 while the wheels roll."""
    coast = record(rig, coasting_rad_s, _COAST_PERIOD_S, _COAST_S, lambda *_: (0.0, 0.0), _SLOWEST_RAD_S)
    sessions = [_session("coast", coast)]
    for number, duty in enumerate((0.55, DUTY, 0.65), 1):
        noisy = replace(rig, seed=rig.seed ^ number)
        step = record(noisy, braking_rad_s, _BRAKE_PERIOD_S, _BRAKE_S, _step_to(duty), _SLOWEST_RAD_S)
        sessions.append(_session(f"brake {duty:g}", step))
    return sessions


def _step_to(duty: float) -> Decide:
    return lambda time_s, _: (0.0, duty if time_s >= _BRAKING_FROM_S else 0.0)


def _session(name: str, recorded: Recording) -> dict[str, Any]:
    time_s = np.arange(len(recorded)) * recorded.period_s
    columns = {name: getattr(recorded, name) for name in ("wheel_count", "road_count", "drive", "brake")}
    return {"name": name, "time_s": time_s.tolist(), **{key: column.tolist() for key, column in columns.items()}}


def _checked(given: Any) -> dict[str, tuple[float, float, float]]:
    """Value and interval of each parameter."""
    found = {}
    for name in _WIDTHS:
        one = given.get(name) if isinstance(given, Mapping) else None
        if not isinstance(one, list) or len(one) != 3 or not all(type(each) is float for each in one):
            raise SubmissionError(f"identify returned no {name!r}: must be (value, low, high)")
        value, low, high = one
        if not low <= value <= high:
            raise SubmissionError(
                f"identify returned {name!r} = {value:g} within {low:g}..{high:g}: must be low <= value <= high"
            )
        found[name] = value, low, high
    return found


def _judged(found: Mapping[str, tuple[float, float, float]], true: Mapping[str, float]) -> dict[str, float]:
    """Errors, share of the intervals that miss, and their mean score over that of the ranges.

    T. Gneiting and A. E. Raftery, Strictly proper scoring rules, prediction, and estimation, 2007, section 6.2.
    """
    errors, scores, missed = {}, list[float](), 0
    for name, (value, low, high) in found.items():
        one = true[name]
        errors[name] = abs(value - one)
        missed += not low <= one <= high
        scores.append((high - low + _OUTSIDE * (max(low - one, 0.0) + max(one - high, 0.0))) / _WIDTHS[name])
    return {**errors, "missed": missed / len(found), "interval score": math.fsum(scores) / len(scores)}
