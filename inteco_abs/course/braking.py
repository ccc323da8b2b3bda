"""Grades a controller: stops of drawn rigs, judged by the true slip, beside two other laws on the same rigs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, cast

from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import CONTROLLERS, Controller, control_check, preferred_estimator
from inteco_abs.course.exercise import Exercise
from inteco_abs.course.measured import Draw, Measured, median
from inteco_abs.course.submission import RemoteController, Submission
from inteco_abs.errors import AbsError
from inteco_abs.montecarlo import ESTIMATOR_NAMES, Oracle, StopResults, run_stops
from inteco_abs.rig import RigVariation

_OWN = "submission"


def brake(exercise: Exercise, submission: Submission, draw: Draw) -> Measured:
    """One stop of each rig. Raises SubmissionError."""
    rigs = draw.rigs()
    own = _own_stops(exercise, submission, list(rigs.values()))
    measure = exercise.score.measure
    zero, hundred = (
        median(_stops_of(law, exercise, list(rigs.values()))[measure].tolist())
        for law in (exercise.score.zero, exercise.score.hundred)
    )
    values = {limit.measure: own[limit.measure].tolist() for limit in exercise.limits}
    notes = tuple(f"ended early: {rig}: {error}" for rig, error in zip(rigs, own.errors, strict=True) if error)
    return Measured(tuple(rigs), values, median(own[measure].tolist()), zero, hundred, notes)


def _own_stops(exercise: Exercise, submission: Submission, rigs: Sequence[RigVariation]) -> StopResults:
    controllers = {_OWN: cast("type[Controller]", RemoteController(submission))}
    try:
        stops = run_stops(rigs, _config(exercise, {"name": _OWN}, controllers), controllers=controllers)
    except AbsError:
        if submission.failure is None:
            raise
    if submission.failure is not None:
        raise submission.failure
    return stops


def _stops_of(law: Any, exercise: Exercise, rigs: Sequence[RigVariation]) -> StopResults:
    """Stops of a law that ships, or of the oracle."""
    if law.get("oracle"):
        config = load_config(
            settings=["controller.name=predictive-reaching"], checks=[control_check()], follows=preferred_estimator()
        )
        return run_stops(rigs, config, maker=Oracle(config))
    table = {"name": law["controller"], "gains": law.get("gains", {})}
    return run_stops(rigs, _config(exercise, table, CONTROLLERS))


def _config(exercise: Exercise, controller: dict[str, Any], controllers: Mapping[str, type[Controller]]) -> RigConfig:
    gains = [f"controller.gains.{name}={value!r}" for name, value in controller.get("gains", {}).items()]
    settings = [f"controller.name={json.dumps(controller['name'])}", *gains, *exercise.settings]
    return load_config(settings=settings, checks=[control_check(controllers, ESTIMATOR_NAMES)])
