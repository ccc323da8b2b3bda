"""Decisions on many logged ticks in one compiled loop, where estimator and controller are functions."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from inteco_abs.analysis.tolerance import Array
from inteco_abs.control import (
    Controller,
    Estimator,
    Function,
    Pipeline,
    admit_request,
    advance_phase,
    finite_demand,
    finite_estimate,
    function_of,
)
from inteco_abs.format import TICK
from inteco_abs.machine_code import compile_problem, compiled, is_compiled, record, records
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


def replay_rows(pipeline: Pipeline, logged: Array, may_compile: bool) -> Array | None:
    """A copy of `logged`, also of what lies between its columns, with what a new `pipeline` decides on its inputs.

    None where Python has to decide: for a part that is not a function or cannot be compiled, times that go back, and
    numbers that are not finite; and, unless it `may_compile`, where there is no machine code yet. The pipeline is left
    as it was.
    """
    machine, guard = pipeline.machine, pipeline.guard
    parts = _control_records(pipeline.estimator, machine.controller)
    if parts is None or not _ordinary(logged):
        return None
    sequence = SequenceRecords(*map(record, (machine.k, machine, guard.k, guard)))
    rows = logged.view(np.uint8).copy().view(logged.dtype)
    loop = _bound(decide_rows, pipeline.estimator, machine.controller)
    return rows if _run(loop, (parts, sequence, rows, pipeline.reference_slip), may_compile) else None


def demand_rows(
    estimator: Estimator, controller: Controller, logged: Array, dtype: np.dtype[Any], may_compile: bool
) -> Array | None:
    """Rows of type `dtype` with slip, torque and duty that new parts demand for each row; None as by `replay_rows`."""
    parts = _control_records(estimator, controller)
    if parts is None or not _ordinary(logged):
        return None
    rows = np.zeros(len(logged), dtype)
    return rows if _run(_bound(ask_rows, estimator, controller), (parts, logged, rows), may_compile) else None


def _control_records(estimator: Any, controller: Any) -> ControlRecords | None:
    if function_of(estimator) is None or function_of(controller) is None:
        return None
    try:
        return ControlRecords(
            record(estimator.k), record(estimator), record(controller.k), records(controller, controller)
        )
    except (AttributeError, TypeError, ValueError):  # a user's function on something else than dataclasses of numbers
        return None


def _ordinary(logged: Array) -> bool:
    if logged.dtype != TICK.dtype or not logged.flags.c_contiguous:
        return False
    times_ns, most = logged["time_ns"], _MOST_COUNTS
    small = all(((-most < logged[name]) & (logged[name] < most)).all() for name in ("wheel_count", "road_count"))
    return bool(small and (times_ns < _LATEST_NS).all() and (times_ns[1:] >= times_ns[:-1]).all())


def _bound(loop: Function, estimator: Estimator, controller: Controller) -> Function:
    return partial(loop, estimate=function_of(estimator), control=function_of(controller))


def _run(loop: Function, arguments: tuple[Any, ...], may_compile: bool) -> bool:
    if not (may_compile or is_compiled(loop)) or compile_problem(loop, arguments):
        return False
    try:
        return bool(compiled(loop)(*arguments))
    except ValueError:
        return False


def decide_rows(
    parts: ControlRecords,
    sequence: SequenceRecords,
    rows: Any,
    reference_slip: float,
    estimate: Function,
    control: Function,
) -> bool:
    """Decide as `Pipeline.step` on the inputs of each row, and write the outputs into it.

    False as soon as a number is not finite, where Python may raise and this does not.
    """
    (estimator_k, estimator, controller_k, controllers), (machine_k, machine, guard_k, guard) = parts, sequence
    wheel_speed, road_speed, slip, valid, drive, brake = 0.0, 0.0, 0.0, False, 0.0, 0.0
    last = nothing = BrakeDemand(0.0, 0.0, 0.0, (0.0, 0.0, 0.0, 0.0))
    for i in range(rows.size):
        row = rows[i]
        flags, request = _signed(row.board_flags), _signed(row.stop_request)
        sample = Sample(_signed(row.tick), _signed(row.time_ns), row.dt_s, row.wheel_count, row.road_count, flags)
        if not flags:
            estimated = estimate(estimator_k, estimator, sample, Command(drive, brake))
            wheel_speed, road_speed, slip, valid, _ = estimated
            phase = machine.phase
            if phase == _BRAKING:
                last = control(controller_k, controllers[0], estimated, row.dt_s)
            if not (finite_estimate(estimated) and finite_demand(last)):
                return False
            advance_phase(machine_k, machine, sample, last.brake)
            if phase == _STOPPED and machine.phase == _IDLE:
                last = nothing
                controllers[0] = controllers[1]
        admit_request(guard_k, guard, machine, sample, request)
        if machine.held or guard.drive != drive or guard.brake != brake:
            drive, brake = guard.drive, guard.brake
        row.wheel_speed_rad_s, row.road_speed_rad_s, row.slip, row.estimate_valid = wheel_speed, road_speed, slip, valid
        row.phase, row.reason = machine.phase, guard.reason
        row.slip_reference = reference_slip if machine.phase == _BRAKING else math.nan
        demand = last if machine.held else nothing
        row.switching, row.torque_demand_nm = demand.switching, demand.torque_nm
        row.c0, row.c1, row.c2, row.c3 = demand.internals
        row.drive_request, row.brake_request = machine.drive_request, machine.brake_request
        row.drive, row.brake = drive, brake
    return True


def ask_rows(parts: ControlRecords, logged: Any, rows: Any, estimate: Function, control: Function) -> bool:
    """Slip, torque and duty for the counts of each row of `logged`, in its phases; False as by `decide_rows`.

    A new stop begins with a new controller. Without a valid sample the demand stays.
    """
    estimator_k, estimator, controller_k, controllers = parts
    slip, torque_nm, brake, held_nm, held, drive, duty, before = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0
    for i in range(rows.size):
        seen, row = logged[i], rows[i]
        if seen.board_flags == 0:
            sample = Sample(
                _signed(seen.tick), _signed(seen.time_ns), seen.dt_s, seen.wheel_count, seen.road_count, _VALID
            )
            estimated = estimate(estimator_k, estimator, sample, Command(drive, duty))
            slip, torque_nm, brake = estimated.slip, 0.0, 0.0
            if before == _BRAKING:
                demand = control(controller_k, controllers[0], estimated, seen.dt_s)
                if not finite_demand(demand):
                    return False
                held_nm, held = demand.torque_nm, demand.brake
            elif before == _STOPPED and seen.phase != _STOPPED:
                controllers[0] = controllers[1]
            if not finite_estimate(estimated):
                return False
            if before == _BRAKING or (before == _STOPPED and seen.phase == _STOPPED):
                torque_nm, brake = held_nm, held
        row.slip, row.torque_demand_nm, row.brake_request = slip, torque_nm, brake
        drive, duty, before = seen.drive, seen.brake, _signed(seen.phase)
    return True
