"""Grades a monitor: recordings of runs with one fault or none, sample by sample; it names the fault."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.config import load_config
from inteco_abs.control import Guard
from inteco_abs.course.exercise import Exercise
from inteco_abs.course.measured import Draw, Measured, median
from inteco_abs.course.recordings import COUNTS_PER_TURN, Recording, Whole, record
from inteco_abs.course.submission import Submission
from inteco_abs.rig import Plant, RigVariation
from inteco_abs.signals import BoardFlags, Command, Estimate, Reason, Sample

FAULTS: Final = (
    "wheel-stuck", "road-stuck", "wheel-slips", "road-slips", "wheel-reversed",
    "brake-dead", "brake-stuck", "drive-dead",
)  # fmt: skip
"""Names of the faults, those of `inteco-abs faults`."""
_HEALTHY: Final = 0.3
"""Share of the recordings without a fault."""
_PERIOD_S: Final = 0.001
_LONGEST_S: Final = 2.0
_SLOWEST_RAD_S: Final = 25.0
LATE_S: Final = 0.3
"""Delay after which a fault counts as not found."""


class _Fault(NamedTuple):
    name: str
    at_s: float
    size: float
    """Share of lost counts, or duty of a brake that is stuck."""


class _Said(NamedTuple):
    name: str
    at_s: float


def watch(exercise: Exercise, submission: Submission, draw: Draw) -> Measured:
    """One recording of each rig. Raises SubmissionError."""
    numbers, cases, costs = draw.numbers("runs"), list[str](), list[float]()
    guarded = list[float]()
    values: dict[str, list[float | None]] = {limit.measure: [] for limit in exercise.limits}
    for number, rig in enumerate(draw.rigs().values(), 1):
        fault, run = _run(rig, numbers)
        said = _said(submission, run)
        if fault is not None:
            guarded.append(_tripped_s(run) - fault.at_s)
        found = _found(fault, said)
        cases.append(f"recording {number}: {_described(fault)}; {_described(said, 'silence')}")
        costs.append(1.0 - found["worth"])
        for name, column in values.items():
            column.append(found.get(name))
    own = math.fsum(costs) / len(costs)
    zero, hundred = float(exercise.score.zero), float(exercise.score.hundred)  # type: ignore[arg-type]
    noticed = sorted(delay_s for delay_s in guarded if 0.0 <= delay_s <= LATE_S)
    when = f", half of them within {median(noticed):.3f} s" if noticed else ""
    note = f"a run's guard, which names none, notices {len(noticed)} of these {len(guarded)} faults{when}"
    return Measured(tuple(cases), values, own, zero, hundred, (note,))


def _tripped_s(run: Recording) -> float:
    """When the guard would have ended the run, or infinity."""
    guard = Guard(load_config(settings=[f"loop.rate_hz={1.0 / run.period_s:g}"]))
    for row in range(len(run)):
        tick, time_ns, dt_s, wheel, road, drive, brake = run.sample(row)
        sample = Sample(tick, time_ns, dt_s, wheel, road, BoardFlags.NONE)
        guard.admit(Command(drive, brake), sample, Estimate(0.0, 0.0, 0.0, valid=False))
        if guard.reason is not Reason.NONE:
            return row * run.period_s
    return math.inf


def _described(what: _Fault | _Said | None, nothing: str = "no fault") -> str:
    return f"{what.name} at {what.at_s:.3f} s" if what else nothing


def _said(submission: Submission, run: Recording) -> _Said | None:
    submission.ask("observer", COUNTS_PER_TURN, run.period_s)
    for tick in range(len(run)):
        name = submission.name("watch", *run.sample(tick))
        if name:
            return _Said(name, tick * run.period_s)
    return None


def _found(fault: _Fault | None, said: _Said | None) -> dict[str, float]:
    """Each measure of one recording that it has, and what it is worth: 0 to 1."""
    early = said is not None and (fault is None or said.at_s < fault.at_s)
    if fault is None:
        return {"false alarm": float(early), "worth": 0.0 if early else 1.0}
    delay_s = math.nan if said is None or early else said.at_s - fault.at_s
    right = said is not None and said.name == fault.name and delay_s <= LATE_S
    worth = 1.0 - 0.5 * delay_s / LATE_S if right else 0.0
    return {
        "false alarm": float(early),
        "not found": float(not right),
        "delay": delay_s if right else math.nan,
        "worth": worth,
    }


def _run(rig: RigVariation, numbers: random.Random) -> tuple[_Fault | None, Recording]:
    """Drive, then brake to slip 0.2, with a fault somewhere."""
    driving_s, rolling_rad_s = numbers.uniform(0.5, 0.9), numbers.uniform(110.0, 150.0)
    fault = _drawn(driving_s, numbers)
    run = record(rig, rolling_rad_s, _PERIOD_S, _LONGEST_S, _law(driving_s), _SLOWEST_RAD_S, _broken(fault))
    return fault, run if fault is None else _miscounted(run, fault)


def _drawn(driving_s: float, numbers: random.Random) -> _Fault | None:
    if numbers.random() < _HEALTHY:
        return None
    name = numbers.choice(FAULTS)
    if name in {"drive-dead", "brake-stuck"}:
        at_s = numbers.uniform(0.1, driving_s - 0.35)
    elif name == "brake-dead":
        at_s = driving_s + numbers.uniform(0.0, 0.35)
    else:
        at_s = numbers.uniform(0.1, driving_s + 0.3)
    size = numbers.uniform(0.55, 0.65) if name == "brake-stuck" else numbers.uniform(0.25, 0.5)
    return _Fault(name, round(at_s / _PERIOD_S) * _PERIOD_S, size)


def _law(driving_s: float) -> Callable[[float, Plant], tuple[float, float]]:
    def decide(time_s: float, plant: Plant) -> tuple[float, float]:
        if time_s < driving_s:
            return 1.0, 0.0
        return 0.0, min(max(0.6 + 2.0 * plant.road_speed / 180.0 * (0.2 - plant.slip), 0.0), 1.0)

    return decide


def _broken(fault: _Fault | None) -> Callable[[float, float, float], tuple[float, float]]:
    """What acts on the rig of what is demanded."""

    def acts(time_s: float, drive: float, brake: float) -> tuple[float, float]:
        if fault is None or time_s < fault.at_s:
            return drive, brake
        dead = {"drive-dead": (0.0, brake), "brake-dead": (drive, 0.0), "brake-stuck": (drive, fault.size)}
        return dead.get(fault.name, (drive, brake))

    return acts


def _miscounted(run: Recording, fault: _Fault) -> Recording:
    """The recording with the counts of a broken encoder."""
    wheel, _, kind = fault.name.partition("-")
    if wheel not in {"wheel", "road"}:
        return run
    share = {"stuck": 0.0, "slips": 1.0 - fault.size, "reversed": -1.0}[kind]
    from_tick = round(fault.at_s / run.period_s)
    if wheel == "wheel":
        return replace(run, wheel_count=_scaled(run.wheel_count, from_tick, share))
    return replace(run, road_count=_scaled(run.road_count, from_tick, share))


def _scaled(counts: Whole, from_tick: int, share: float) -> Whole:
    later = counts[from_tick] + np.floor(share * (counts[from_tick:] - counts[from_tick])).astype(np.int64)
    return np.concatenate([counts[:from_tick], later])
