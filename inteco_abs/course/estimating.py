"""Grades an estimator: stops with a slip that moves about, judged by the true speeds and slip."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from inteco_abs.config import load_config
from inteco_abs.control import make_estimator
from inteco_abs.course.exercise import Exercise
from inteco_abs.course.measured import Draw, Measured, median
from inteco_abs.course.recordings import COUNTS_PER_TURN, Decide, Floats, Recording, record
from inteco_abs.course.submission import Submission
from inteco_abs.rig import Plant
from inteco_abs.signals import BoardFlags, Command, Sample

_PERIOD_S: Final = 0.0005
_LONGEST_S: Final = 1.8
_ROLLING_S: Final = 0.2
_SLOWEST_RAD_S: Final = 10.0
_JUDGED_FROM_S: Final = 0.1
_MEASURES: Final = ("wheel_error_rad_s", "road_error_rad_s", "slip_error")


def estimate(exercise: Exercise, submission: Submission, draw: Draw) -> Measured:
    """One recording of each rig, sample by sample. Raises SubmissionError."""
    rigs, numbers = draw.rigs(), draw.numbers("stops")
    stops = [record(rig, *_start(numbers), _wandering(numbers), _SLOWEST_RAD_S) for rig in rigs.values()]
    own = [_errors(stop, _own(submission, stop)) for stop in stops]
    zero, hundred = (
        median([_errors(stop, _shipped(law["estimator"], stop))[-1] for stop in stops])
        for law in (exercise.score.zero, exercise.score.hundred)
        if not isinstance(law, float)
    )
    values = {name: [errors[i] for errors in own] for i, name in enumerate(_MEASURES)}
    return Measured(tuple(rigs), values, median(values[exercise.score.measure]), zero, hundred)


def _start(numbers: random.Random) -> tuple[float, float, float]:
    return numbers.uniform(140.0, 175.0), _PERIOD_S, _LONGEST_S


def _wandering(numbers: random.Random) -> Decide:
    """Roll, then brake towards slips that change at times that only these numbers know."""
    braking_s = numbers.uniform(0.5, 1.0) * _ROLLING_S
    wanted, change_s = 0.2, braking_s

    def decide(time_s: float, plant: Plant) -> tuple[float, float]:
        nonlocal wanted, change_s
        if time_s < braking_s:
            return 1.0, 0.0
        if time_s >= change_s:
            wanted, change_s = numbers.uniform(0.03, 0.4), change_s + numbers.uniform(0.15, 0.4)
        error = wanted - plant.slip
        return 0.0, min(max(0.6 + 2.0 * plant.road_speed / 180.0 * error, 0.0), 1.0)

    return decide


def _own(submission: Submission, stop: Recording) -> Iterator[Sequence[float]]:
    submission.ask("observer", COUNTS_PER_TURN, stop.period_s)
    for tick in range(len(stop)):
        yield submission.numbers(3, "estimate", *stop.sample(tick))


def _shipped(name: str, stop: Recording) -> Iterator[Sequence[float]]:
    estimator = make_estimator(load_config(settings=[f"estimator.name={name}"]))
    for row in range(len(stop)):
        tick, time_ns, dt_s, wheel, road, drive, brake = stop.sample(row)
        sample = Sample(tick, time_ns, dt_s, wheel, road, BoardFlags.NONE)
        yield estimator.update(sample, Command(drive, brake))[:3]


def _errors(stop: Recording, estimates: Iterator[Sequence[float]]) -> list[float]:
    """RMS of the errors of both speeds in rad/s, and of the slip."""
    found = np.array(list(estimates), np.float64).T
    truth: Any = (stop.wheel_speed_rad_s, stop.road_speed_rad_s, stop.slip)
    from_tick = round(_JUDGED_FROM_S / stop.period_s)
    return [_rms(one - true, from_tick) for one, true in zip(found, truth, strict=True)]


def _rms(errors: Floats, from_tick: int) -> float:
    return float(np.sqrt(np.mean(errors[from_tick:] ** 2)))
