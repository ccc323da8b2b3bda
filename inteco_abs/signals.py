"""The values on the path from the board to the log: immutable, with SI units in their names."""

from __future__ import annotations

import math
from enum import IntEnum, IntFlag
from typing import ClassVar, Final, NamedTuple

_EXACT: Final = 1e-9
"""Keeps a duty that is a whole number of steps from losing one to binary rounding."""


class BoardFlags(IntFlag):
    """Faults of a sample's exchange."""

    NONE = 0
    STALE = 1
    """The exchange failed: the counts are those of the last good sample."""
    SLOW = 2
    """The exchange took longer than a period: the counts are good, but their instant is uncertain."""


class Phase(IntEnum):
    """Phase of the experiment."""

    UNKNOWN = 0
    IDLE = 1
    """Outputs off, watching that both wheels stand still."""
    ARMED = 2
    """Outputs off, about to drive."""
    SPIN_UP = 3
    """Drive on until the start speed."""
    BRAKING = 4
    """Drive off, controller brakes; its first tick has both outputs off."""
    STOPPED = 5
    """Road wheel at rest, brake still held."""
    DONE = 6
    """Outputs off, nothing left to do."""
    FAULT = 7
    """Outputs off for a reason, latched."""


class Reason(IntEnum):
    """Why the outputs were switched off; the first reason stays."""

    NONE = 0
    OPERATOR_STOP = 1
    WHEELS_MOVING = 2
    SPIN_UP_TIMEOUT = 3
    BRAKING_TIMEOUT = 4
    BAD_OUTPUT = 5
    OVER_SPEED = 6
    ROAD_ENCODER_FROZEN = 7
    ENCODERS_DISAGREE = 8
    COUNT_JUMP = 9
    ROAD_BACKWARDS = 10
    MISSED_EXCHANGES = 11
    CONTROLLER_ERROR = 12
    GUARDIAN_LOST = 13
    SUPERVISOR_LOST = 14
    RECORDER_LOST = 15
    RUN_UP_IMPLAUSIBLE = 16


EXPLANATIONS: Final[dict[Reason, str]] = {
    Reason.NONE: "no fault",
    Reason.OPERATOR_STOP: "the operator stopped the run",
    Reason.WHEELS_MOVING: (
        "a wheel moved before the start: wait until both stand still; if a motor turns it, press the emergency switch"
    ),
    Reason.SPIN_UP_TIMEOUT: "the start speed was not reached in time: check the drive's power and the emergency switch",
    Reason.BRAKING_TIMEOUT: "the road wheel did not stop in time: check the brake's power and the controller's gains",
    Reason.BAD_OUTPUT: "the controller asked for a duty that is not a finite number",
    Reason.OVER_SPEED: "a wheel turned faster than the limit",
    Reason.ROAD_ENCODER_FROZEN: "the road wheel's encoder loses counts although the wheel must turn: check its "
    "cable, the drive's power and the emergency switch",
    Reason.ENCODERS_DISAGREE: "the two encoders do not agree: check their cables, signs and counts per turn, "
    "whether they are swapped, and whether the brake is stuck",
    Reason.COUNT_JUMP: "an encoder count changed faster than any wheel can turn: check cable and shield",
    Reason.ROAD_BACKWARDS: "the road wheel counts backwards: check the encoder's sign in the profile and the wiring",
    Reason.MISSED_EXCHANGES: "too many exchanges with the board were late, slow or failed",
    Reason.CONTROLLER_ERROR: "the controller or estimator failed",
    Reason.GUARDIAN_LOST: "the guardian process died or hung, and it is what stops the motors if the loop dies",
    Reason.SUPERVISOR_LOST: "the program that was started died, hung or was held up, perhaps by Ctrl-S, so the "
    "operator could not have stopped the run",
    Reason.RECORDER_LOST: "the recorder process died or hung, or could not write the session",
    Reason.RUN_UP_IMPLAUSIBLE: "the road wheel gains speed faster or slower than the drive motor can make it: check "
    "encoders.counts_per_turn first, then the drive's power and the emergency switch, and whether something rubs",
}
"""Each reason for the person at the rig, with what to check."""


class Sample(NamedTuple):
    """What was measured, at the instant the board was read."""

    tick: int
    """Number of this exchange, from 0."""
    time_ns: int
    """Monotonic clock, ns."""
    dt_s: float
    """Time since the previous sample, s; at the first sample, the nominal period."""
    wheel_count: int
    """Upper wheel's quadrature count, unwrapped, signed, 0 at open."""
    road_count: int
    """Lower wheel's quadrature count, unwrapped, signed, 0 at open."""
    board_flags: BoardFlags = BoardFlags.NONE


class Prediction(NamedTuple):
    """Prediction of a model-based observer for the instant at which the next command acts on the brake."""

    wheel_angle_rad: float
    wheel_speed_rad_s: float
    road_speed_rad_s: float
    lagged_torque_nm: float
    """Torque by the brake's map and lag from the commands so far."""
    excess_torque_nm: float
    """Torque of the brake beyond that."""
    adhesion_factor: float
    """Factor on the adhesion of equation (8)."""
    ripple_cosine: float
    """Ripple of that factor over the wheel's angle."""
    ripple_sine: float
    brake_dead_time_s: float
    brake_lag_s: float
    brake_release_ratio: float = 1.0
    """Its lag in releasing, as a share of that."""
    slowest_release_ratio: float = 1.0
    """What that ratio may well be, as far as it is not known; 1 where the observer takes release and rise for equal."""


class Estimate(NamedTuple):
    """Speeds and slip from the samples so far."""

    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    """Slip, 0..1."""
    valid: bool
    """False until enough samples were seen."""
    outlook: Prediction | None = None
    """Prediction of an observer while the rig brakes; not in the log, as a replay recomputes it."""


class _Duties(NamedTuple):
    drive: float
    brake: float


class Command(_Duties):
    """Duty cycles of drive and brake in 0..1."""

    __slots__ = ()

    SAFE: ClassVar[Command]
    """Both zero: outputs de-energised. Not a standstill: the wheels coast."""


Command.SAFE = Command(0.0, 0.0)


class BrakeDemand(NamedTuple):
    """A controller's demand, with the values behind it."""

    brake: float
    """Duty, meant to be in 0..1; the guard has the last word."""
    torque_nm: float = 0.0
    """Brake torque demanded, before any limit, N m; 0 if the controller has no torque."""
    switching: float = 0.0
    """Switching function (slip error), or another value that the controller drives to zero."""
    internals: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """Four values for the log; the controller's `internals` names them."""


def pwm_steps(duty: float, full: int) -> int:
    """Of `full` steps of a PWM period, those of a duty in 0..1, rounded down: never more than the guard admitted."""
    return math.floor(duty * full + _EXACT)


class Timing(NamedTuple):
    """Timing of a tick, in microseconds."""

    late_us: float
    """Start of the tick minus its deadline; paced by the board, how much later its report came than the quickest."""
    io_us: float
    """Duration of the exchange with the board; paced by the board, of sending the command before."""
    busy_us: float
    """Time of the previous tick after its exchange: decision and record."""
    skipped: int
    """Whole periods that were skipped just before this tick."""


UNTIMED: Final = Timing(0.0, 0.0, 0.0, 0)


class Tick(NamedTuple):
    """One row of a session. Inputs first, then everything that replay recomputes, then timing."""

    time_ns: int
    tick: int
    dt_s: float
    wheel_count: int
    road_count: int
    board_flags: BoardFlags
    stop_request: Reason

    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    estimate_valid: bool
    phase: Phase
    slip_reference: float
    switching: float
    torque_demand_nm: float
    drive_request: float
    brake_request: float
    drive: float
    brake: float
    reason: Reason
    c0: float
    c1: float
    c2: float
    c3: float

    late_us: float
    io_us: float
    busy_us: float
    skipped: int
