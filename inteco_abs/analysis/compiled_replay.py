"""Decisions on many logged ticks in one compiled loop, where estimator and controller are functions."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from inteco_abs.analysis.tolerance import Array
from inteco_abs.bound_function import is_own
from inteco_abs.control import (
    REFERENCE,
    Controller,
    DecisionState,
    Estimator,
    Function,
    GainChange,
    Pipeline,
    advance_and_admit,
    finite_demand,
    finite_estimate,
    function_of,
    reference_function,
    set_gain,
)
from inteco_abs.format import TICK
from inteco_abs.kept_loop import KeptLoop
from inteco_abs.records import record, records, restore
from inteco_abs.signals import BrakeDemand, Command, Phase, Sample

_IDLE, _BRAKING, _STOPPED = Phase.IDLE, Phase.BRAKING, Phase.STOPPED
_LATEST_NS: Final = 1 << 60
_MOST_COUNTS: Final = 1 << 40
"""Below both, integers of 64 bits hold all that estimators and guard compute of them."""
_signed: Final[Any] = np.int64
"""An unsigned and a signed number of 64 bits would make a float."""
_VALID: Final[Any] = 0
"""Flags of a sample."""


class ControlRecords(NamedTuple):
    """Records of the constants and the state of estimator and controller."""

    estimator_k: Any
    estimator: Any
    controller_k: Any
    controllers: Any
    """That of this stop, and one as each stop begins with it."""


class SequenceRecords(NamedTuple):
    """Records of the constants and the state of phase machine and guard."""

    machine_k: Any
    machine: Any
    guard_k: Any
    guard: Any
    decided: Any
    """A `DecisionState`."""
    reference_slip: float


class CompiledReplay:
    """A new `pipeline` that decides in machine code, block by block; the pipeline itself stays as it was.

    `changes` are those of gains, by tick.
    """

    def __init__(self, pipeline: Pipeline, may_compile: bool, changes: Iterable[GainChange] = ()) -> None:
        self._changes = deque(changes)
        self._controller: Any = deepcopy(pipeline.machine.controller) if self._changes else None
        self._records = pipeline_records(pipeline)
        self._loop = None
        if self._records is not None:
            self._loop = KeptLoop(partial(decide_rows, decide=function_of_pipeline(pipeline)), may_make=may_compile)
        self._newest_ns = 0

    def decide(self, logged: Array) -> Array | None:
        """A copy of the next rows, also of what lies between their columns, with what it decides on their inputs.

        None where Python has to decide: for a part that is not a function or cannot be compiled, times that go back,
        and numbers that are not finite; and, unless it may compile, where there is no machine code yet.
        """
        if self._records is None or self._loop is None or not _ordinary(logged, self._newest_ns):
            return None
        self._newest_ns = int(logged["time_ns"][-1])
        rows = logged.view(np.uint8).copy().view(logged.dtype)
        start = 0
        while self._changes and (end := int(rows["tick"].searchsorted(self._changes[0].tick))) < len(rows):
            if not self._decide(rows[start:end]) or not self._change(*self._changes.popleft()):
                return None
            start = end
        return rows if self._decide(rows[start:]) else None

    def _decide(self, rows: Array) -> bool:
        loop, records = self._loop, self._records
        if loop is None or records is None:
            return False
        return not len(rows) or loop.run(*records, rows)

    def _change(self, _tick: int, name: str, value: float) -> bool:
        """Change a gain in the records; False where Python has to."""
        try:
            set_gain(self._controller, name, value)
        except (AttributeError, TypeError, ValueError):  # it has no such gain
            return False
        self._records = self._records and changed_records(self._records, self._controller, name, value)
        return self._records is not None


def pipeline_records(pipeline: Pipeline) -> tuple[ControlRecords, SequenceRecords] | None:
    """Records of all parts of a pipeline, or None where one of them is not a function."""
    machine, guard = pipeline.machine, pipeline.guard
    parts = _control_records(pipeline.estimator, machine.controller, machine.controller_as_made)
    if parts is None:
        return None
    k, s = (record(machine.k), record(guard.k)), (record(machine), record(guard), record(pipeline.decided))
    return parts, SequenceRecords(k[0], s[0], k[1], s[1], s[2], pipeline.reference_slip)


def changed_records(
    found: tuple[ControlRecords, SequenceRecords], controller: Any, name: str, value: float
) -> tuple[ControlRecords, SequenceRecords] | None:
    """Records of a pipeline whose `controller` got a gain or reference; None where the code is not for their kind."""
    parts, sequence = found
    try:
        if name == REFERENCE:
            parts.controllers["reference"], sequence = value, sequence._replace(reference_slip=value)
        k = record(controller.k)
    except (AttributeError, TypeError, ValueError):  # it has no such field
        return None
    return (parts._replace(controller_k=k), sequence) if k.dtype == parts.controller_k.dtype else None


def resume_pipeline(pipeline: Pipeline, found: tuple[ControlRecords, SequenceRecords]) -> None:
    """Give `pipeline` the state in its records, as `pipeline_records` made them."""
    (_, estimator, _, controllers), (_, machine, _, guard, decided, _) = found
    last = pipeline.decided
    restore(estimator, pipeline.estimator)
    restore(controllers[0], pipeline.machine.controller)
    restore(machine, pipeline.machine)
    restore(guard, pipeline.guard)
    restore(decided, last)
    pipeline.resume(last)


def function_of_pipeline(pipeline: Pipeline) -> Function:
    """`decide_row` with the functions of the pipeline's parts."""
    controller = pipeline.machine.controller
    return partial(_bound(decide_row, pipeline.estimator, controller), reference=reference_function(controller))


class CompiledDemands:
    """Demands of a new estimator and controller on logged ticks, in machine code, block by block."""

    def __init__(self, estimator: Estimator, controller: Controller, dtype: np.dtype[Any], may_compile: bool) -> None:
        self._parts = _control_records(estimator, controller, controller)
        asking = _bound(ask_rows, estimator, controller)
        usable = self._parts is not None and is_own(asking)
        self._loop = KeptLoop(asking, may_make=may_compile) if usable else None
        self._dtype = dtype
        self._newest_ns = 0
        self._state = record(AskState())

    def rows(self, logged: Array) -> Array | None:
        """Rows with slip, torque and duty for each of the next ones; None as by `CompiledReplay.decide`.

        None for a user's function, too, as `x**2` is not x*x in Python.
        """
        if self._parts is None or self._loop is None or not _ordinary(logged, self._newest_ns):
            return None
        self._newest_ns = int(logged["time_ns"][-1])
        rows = np.zeros(len(logged), self._dtype)
        return rows if self._loop.run(self._parts, self._state, logged, rows) else None


def _control_records(estimator: Any, controller: Any, as_made: Any) -> ControlRecords | None:
    if function_of(estimator) is None or function_of(controller) is None:
        return None
    try:
        return ControlRecords(
            record(estimator.k), record(estimator), record(controller.k), records(controller, as_made)
        )
    except (AttributeError, TypeError, ValueError):  # a user's function on something else than dataclasses of numbers
        return None


def _ordinary(logged: Array, earliest_ns: int = 0) -> bool:
    if logged.dtype != TICK.dtype or not logged.flags.c_contiguous:
        return False
    times_ns, most = logged["time_ns"], _MOST_COUNTS
    small = all(((-most < logged[name]) & (logged[name] < most)).all() for name in ("wheel_count", "road_count"))
    forward = len(logged) and times_ns[0] >= earliest_ns and (times_ns[1:] >= times_ns[:-1]).all()
    return bool(small and forward and (times_ns < _LATEST_NS).all())


def _bound(loop: Function, estimator: Estimator, controller: Controller) -> Function:
    return partial(loop, estimate=function_of(estimator), control=function_of(controller))


def ordinary_sample(sample: Sample, earliest_ns: int) -> bool:
    """As `CompiledReplay` asks of rows: whether machine code can decide on it."""
    _, time_ns, _, wheel, road, _ = sample
    small = -_MOST_COUNTS < wheel < _MOST_COUNTS and -_MOST_COUNTS < road < _MOST_COUNTS
    return small and earliest_ns <= time_ns < _LATEST_NS


def decide_rows(parts: ControlRecords, sequence: SequenceRecords, rows: Any, decide: Function) -> bool:
    """Decide on each row by `decide_row`; False as soon as that is."""
    for i in range(rows.size):  # noqa: SIM110  numba compiles no generator expression
        if not decide(parts, sequence, rows[i]):
            return False
    return True


def decide_row(
    parts: ControlRecords,
    sequence: SequenceRecords,
    row: Any,
    estimate: Function,
    control: Function,
    reference: Function,
) -> bool:
    """Decide as `Pipeline.step` on the inputs of a row, and write the outputs into it.

    False if a number is not finite, where Python may raise and this does not.
    """
    estimator_k, estimator, controller_k, controllers = parts
    machine_k, machine, guard_k, guard, s, reference_slip = sequence
    flags, request = _signed(row.board_flags), _signed(row.stop_request)
    sample = Sample(_signed(row.tick), _signed(row.time_ns), row.dt_s, row.wheel_count, row.road_count, flags)
    phase = machine.phase
    if not flags:
        estimated = estimate(estimator_k, estimator, sample, Command(s.drive, s.brake))
        s.wheel_speed, s.road_speed, s.slip, s.valid, _ = estimated
        if phase == _BRAKING:
            demand = control(controller_k, controllers[0], estimated, row.dt_s)
            if not finite_demand(demand):
                return False
            _note(s, demand)
        if not finite_estimate(estimated):
            return False
    advance_and_admit((machine_k, guard_k), (machine, guard), sample, s.demanded, request)
    if phase == _STOPPED and machine.phase == _IDLE:
        _note(s, BrakeDemand(0.0, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0)))
        controllers[0] = controllers[1]
    held = machine.held
    if held or guard.drive != s.drive or guard.brake != s.brake:
        s.drive, s.brake = guard.drive, guard.brake
    row.wheel_speed_rad_s, row.road_speed_rad_s, row.slip = s.wheel_speed, s.road_speed, s.slip
    row.estimate_valid, row.phase, row.reason = s.valid, machine.phase, guard.reason
    row.slip_reference = reference(controllers[0], reference_slip) if machine.phase == _BRAKING else math.nan
    row.switching, row.torque_demand_nm = (s.switching, s.torque_nm) if held else (0.0, 0.0)
    row.c0, row.c1, row.c2, row.c3 = (s.c0, s.c1, s.c2, s.c3) if held else (0.0, 0.0, 0.0, 0.0)
    row.drive_request, row.brake_request = machine.drive_request, machine.brake_request
    row.drive, row.brake = s.drive, s.brake
    return True


def _note(s: DecisionState, demand: BrakeDemand) -> None:
    s.demanded, s.torque_nm, s.switching, (s.c0, s.c1, s.c2, s.c3) = demand


@dataclass(slots=True)
class AskState:
    """What a tick leaves to the next one: its demand, the held one, and the log's command and phase."""

    slip: float = 0.0
    torque_nm: float = 0.0
    brake: float = 0.0
    held_torque_nm: float = 0.0
    held_brake: float = 0.0
    drive: float = 0.0
    duty: float = 0.0
    phase: int = 0


def ask_rows(parts: ControlRecords, s: Any, logged: Any, rows: Any, estimate: Function, control: Function) -> bool:
    """Slip, torque and duty for the counts of each row of `logged`, in its phases; False as by `decide_rows`.

    A new stop begins with a new controller. Without a valid sample the demand stays.
    """
    estimator_k, estimator, controller_k, controllers = parts
    for i in range(rows.size):
        seen, row = logged[i], rows[i]
        if seen.board_flags == 0:
            sample = Sample(
                _signed(seen.tick), _signed(seen.time_ns), seen.dt_s, seen.wheel_count, seen.road_count, _VALID
            )
            estimated = estimate(estimator_k, estimator, sample, Command(s.drive, s.duty))
            s.slip, s.torque_nm, s.brake = estimated.slip, 0.0, 0.0
            if s.phase == _BRAKING:
                demand = control(controller_k, controllers[0], estimated, seen.dt_s)
                if not finite_demand(demand):
                    return False
                s.held_torque_nm, s.held_brake = demand.torque_nm, demand.brake
            elif s.phase == _STOPPED and seen.phase != _STOPPED:
                controllers[0] = controllers[1]
            if not finite_estimate(estimated):
                return False
            if s.phase == _BRAKING or (s.phase == _STOPPED and seen.phase == _STOPPED):
                s.torque_nm, s.brake = s.held_torque_nm, s.held_brake
        row.slip, row.torque_demand_nm, row.brake_request = s.slip, s.torque_nm, s.brake
        s.drive, s.duty, s.phase = seen.drive, seen.brake, _signed(seen.phase)
    return True
