"""Whole stops of one rig after the other, compiled, where the estimator is a function."""

from __future__ import annotations

from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.config import RigConfig
from inteco_abs.control import (
    Function,
    Guard,
    PhaseMachine,
    advance_and_admit,
    finite_demand,
    finite_estimate,
    function_of,
    reference_function,
)
from inteco_abs.records import record
from inteco_abs.rig.model import true_slip
from inteco_abs.rig.plant import move_on, read_encoders
from inteco_abs.sessions import STANDSTILL_RAD_S
from inteco_abs.signals import Command, Phase, Reason, Sample

COLUMNS: Final = 9
"""Speeds of wheel and road, slip, brake torque, road angle, estimated slip, the brake's duty, reference slip, and the
law's slip error."""
_ON_THE_WAY: Final = 64
"""Commands of one rig for which there is room at first."""
_NONE: Final = Reason.NONE
_NO_FLAGS: Final[Any] = 0
_BRAKING: Final = Phase.BRAKING


class Parts(NamedTuple):
    """Records of the constants and the state of each part of the decision path."""

    estimator_k: Any
    estimator: Any
    controller_k: Any
    controller: Any
    machine_k: Any
    machine: Any
    guard_k: Any
    guard: Any


class Course(NamedTuple):
    """How a stop went."""

    began: int
    """Tick at which braking began, or -1."""
    ended: int
    """Last tick of the stop."""
    decisions: int
    reason: int
    """Why the guard ended it, or NONE."""
    finite: bool
    """False where a number was not: there Python may raise what the compiled stop does not."""


def function_of_stop(estimator: object, controller: object) -> Function | None:
    """`stop` with these two, or None where one of them is not a function."""
    estimate, control = function_of(estimator), function_of(controller)
    if estimate is None or control is None:
        return None
    return partial(stop, estimate=estimate, control=control, reference=reference_function(controller))


def parts_of(config: RigConfig, estimator: Any, controller: Any, phase: Phase) -> Parts:
    """The decision path of a configuration, which begins in this phase."""
    machine, guard = PhaseMachine(config, controller, phase), Guard(config)
    every = [each for part in (estimator, controller, machine, guard) for each in (part.k, part)]
    return Parts(*map(record, every))


def stop(
    rig: tuple[Any, Any],
    parts: Parts,
    clock: tuple[int, int, float],
    rows: NDArray[np.float64],
    estimate: Function,
    control: Function,
    reference: Function,
) -> Course:
    """One stop of a `rig`, of which this has constants and state: a row of `rows` for each tick from braking on.

    The `clock` has the period in ns, how many ticks braking may take, and the slip to hold where that is constant.
    Output first: a tick reads and decides, and what was decided goes to the brake the rig's own delay later.
    """
    (k, s), (period_ns, longest, constant), period_s = rig, clock, clock[0] / 1e9
    due_s: Any = np.zeros(_ON_THE_WAY)
    torques: Any = np.zeros(_ON_THE_WAY)
    sent = np.zeros((k.command_delay_ticks + 1, 2))
    tick, began, decisions, slip, brake, error = 0, -1, 0, 0.0, 0.0, 0.0
    machine, guard = parts.machine, parts.guard
    while True:
        reading: Any = np.uint64(tick + 1)
        wheel_count, road_count = read_encoders(k, s, reading)
        ended = began >= 0 and (s.road_speed < STANDSTILL_RAD_S or tick - began >= longest)
        if not ended:
            sample = Sample(tick, tick * period_ns, period_s, wheel_count, road_count, _NO_FLAGS)
            estimated = estimate(parts.estimator_k, parts.estimator, sample, Command(guard.drive, guard.brake))
            finite = finite_estimate(estimated)
            if machine.phase == _BRAKING:
                demand = control(parts.controller_k, parts.controller, estimated, period_s)
                brake, error = demand.brake, demand.switching
                finite = finite and finite_demand(demand)
            if not finite:
                return Course(began, tick, decisions, guard.reason, False)
            advance_and_admit((parts.machine_k, parts.guard_k), (machine, guard), sample, brake, _NONE)
            decisions += 1
            slip = estimated.slip
            ended = guard.reason != _NONE
            if began < 0 and machine.phase == _BRAKING:
                began = tick
        if began >= 0:
            row = rows[tick - began]
            row[0], row[1], row[2] = s.wheel_speed, s.road_speed, true_slip(k, s)
            row[3], row[4], row[5], row[6] = s.brake_torque, s.road_angle, slip, guard.brake
            row[7], row[8] = reference(parts.controller, constant), error
        if ended:
            return Course(began, tick, decisions, guard.reason, True)
        sent[tick % sent.shape[0], 0], sent[tick % sent.shape[0], 1] = guard.drive, guard.brake
        drive, duty = sent[(tick - k.command_delay_ticks) % sent.shape[0]]
        move_on(k, s, due_s, torques, drive, duty, period_s)
        if s.sent - s.arrived == due_s.size:  # at its number modulo the new length each command is where it was
            due_s, torques = np.concatenate((due_s, due_s)), np.concatenate((torques, torques))
        tick += 1
