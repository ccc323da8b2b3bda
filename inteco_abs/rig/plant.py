"""The rig in time: two wheels, the brake's lag, the drive motor.

Integrator: a two-stage Rosenbrock W-method of order 2, L-stable where its matrix is the Jacobian (Verwer's ROS2).
The only stiff term is the contact, whose eigenvalue grows like 1/speed (86 1/s at 180 rad/s, 1556 at 10, without
bound towards standstill). Its Jacobian is a column times a row, so the linear solve is one division, and the order
does not depend on the rest of the Jacobian being left out; where the contact is not stiff it is left out as well,
and the method is Heun's. Towards standstill the step is cut in proportion to the speed, so that the fast slip
motion is followed, not only damped. A wheel that comes to rest inside a step ends that step there.
"""

from __future__ import annotations

import math
from typing import Final

from inteco_abs import elementary
from inteco_abs.rig.actuators import DriveMotor, brake_torque, drive_torque
from inteco_abs.rig.adhesion_curve import road_adhesion
from inteco_abs.rig.brake_actuator import SAME_TIME_S, act_on_arrived, command, heat, settled
from inteco_abs.rig.encoder import count, latch_error_s
from inteco_abs.rig.model import contact_stiffness, rates, true_slip
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.rng import normal_pair
from inteco_abs.rig.state import Constants, State, start_values
from inteco_abs.rig.variation import RigVariation

GAMMA: Final = 1.0 - math.sqrt(0.5)
STIFF: Final = 0.25
"""Step times eigenvalue from which the contact is solved implicitly."""
FOLLOWED: Final = 0.5
"""Largest step times eigenvalue, as long as `MOST_CUTS` allows."""
MOST_CUTS: Final = 16
"""A stiff contact cuts `max_step_s` into at most so many steps, a shorter time into proportionally fewer, so a mock
board in Python keeps real time at low speeds. Compared with 1024, wheels of the published rig that start, coast and are
braked are displaced by less than 2e-4 rad, 1/15 of an encoder's count."""
ALMOST_AT_REST: Final = 1e-9
CRAWL_RAD_S: Final = 0.02
"""Below this the slip has no meaning: the published rig stops within 8 ms, an encoder counts once in 0.15 s."""


class Plant(State):
    """Two wheels in contact, started at given speeds in rad/s with the brake released.

    The rig is given by its parameters or as a `RigVariation`. Speeds, angles (rad), `brake_torque` (N m, what the
    brake can hold) and `time_s` may be read at any time. `max_step_s` bounds the integration step. Raises ValueError
    for speeds that are not finite, and for `max_step_s` outside 0..infinity.
    """

    def __init__(
        self,
        parameters: RigParameters | RigVariation,
        wheel_speed: float,
        road_speed: float,
        motor: DriveMotor | None = None,
        *,
        max_step_s: float = 0.0005,
    ) -> None:
        if not (math.isfinite(wheel_speed) and math.isfinite(road_speed)):
            raise ValueError(f"speeds {wheel_speed!r}, {road_speed!r} rad/s: must be finite")
        if not 0.0 < max_step_s < math.inf:
            raise ValueError(f"max_step_s = {max_step_s!r}: must be finite and above 0 s")
        variation = parameters if isinstance(parameters, RigVariation) else RigVariation(parameters)
        self.parameters = variation.parameters
        self.motor = motor or DriveMotor()
        self.constants = k = Constants.of(variation, self.motor, max_step_s)
        super().__init__(wheel_speed, road_speed, *start_values(k))
        self.settled_torque = self.newest_torque = self.cold_torque = settled(k, 0.0)
        self.commands: tuple[list[float], list[float]] = ([0.0], [0.0])
        """Times in s at which commands act, and their torques in N m: rings, of a power of two."""

    @property
    def slip(self) -> float:
        """Slip in 0..1, equation (7)."""
        return true_slip(self.constants, self)

    @property
    def adhesion(self) -> float:
        """Adhesion coefficient of the road at this slip, equation (8) or the rig's own."""
        return self.grip * road_adhesion(self.constants, self, self.slip)

    def take_road(self, rig: RigVariation) -> None:
        """Go on with `rig`, which is this one on another road, whose changes count from the next brake command."""
        self.braking_since_s = math.inf
        self.constants = k = Constants.of(rig, self.motor, self.constants.max_step_s)
        _, _, self.grip, _, self.road_c1, self.road_c2, self.road_c3 = start_values(k)

    def advance(self, drive: float, brake: float, duration_s: float) -> None:
        """Advance by `duration_s` >= 0 with constant duties in 0..1; raises ValueError outside."""
        if not (0.0 <= drive <= 1.0 and 0.0 <= brake <= 1.0):
            raise ValueError(f"drive {drive!r}, brake {brake!r}: duties must be in 0..1")
        if not 0.0 <= duration_s < math.inf:
            raise ValueError(f"duration_s = {duration_s!r}: must be finite and not negative")
        due_s, torques = self.commands
        move_on(self.constants, self, due_s, torques, drive, brake, duration_s)
        if self.sent - self.arrived == len(due_s):
            due_s += due_s  # at its number modulo the new length each command is where it was
            torques += torques


def read_encoders(k: Constants, s: State, reading: int) -> tuple[int, int]:
    """Counts of wheel and road now, as by `Encoder.read`; `reading` is the number of this one, 1 at first."""
    noise1 = noise2 = 0.0
    if k.wheel_encoder.jitter_counts > 0.0 or k.road_encoder.jitter_counts > 0.0:
        noise1, noise2 = normal_pair(k.noise_seed, reading)
    wheel, road = s.wheel_angle, s.road_angle
    if k.latch_jitter_s > 0.0:
        late_s = latch_error_s(k.latch_jitter_s, k.noise_seed, reading)
        wheel, road = wheel + s.wheel_speed * late_s, road + s.road_speed * late_s
    return count(k.wheel_encoder, wheel, noise1), count(k.road_encoder, road, noise2)


def move_on(
    k: Constants, s: State, due_s: list[float], torques: list[float], drive: float, brake: float, duration_s: float
) -> None:
    """Advance in parts that end where a delayed command acts or the road changes."""
    if k.plain:
        s.settled_torque = brake_torque(brake, k)
        _move(k, s, drive, duration_s)
        s.time_s += duration_s
        return
    if brake != s.newest_duty:
        command(k, s, due_s, torques, brake)
    if drive > 0.0:
        s.braking_since_s = math.inf
    elif brake > 0.0:
        s.braking_since_s = min(s.braking_since_s, s.time_s)
    left_s = duration_s
    while True:
        arrival_s = act_on_arrived(k, s, due_s, torques) if s.arrived < s.sent else math.inf
        change_s = math.inf
        if k.road_changes:
            change_s = _change_road(k, s)
        part_s = min(left_s, min(arrival_s, change_s) - s.time_s)
        _move(k, s, drive, part_s)
        s.time_s += part_s
        if k.brake_fade_per_kj != 0.0 or k.wheel_wear_per_kj > 0.0:
            heat(k, s, part_s)
        if part_s == left_s:
            break
        left_s -= part_s


def _change_road(k: Constants, s: State) -> float:
    """Set the adhesion of this time of the stop; return the time in s of its next change, or infinity."""
    found = (0.0, 0.0, math.inf)
    if k.third_grip_step_after_s > 0.0:
        found = _step_of(s, found, k.third_grip_step_after_s, k.third_grip_step)
    if k.second_grip_step_after_s > 0.0:
        found = _step_of(s, found, k.second_grip_step_after_s, k.second_grip_step)
    step, _, change_s = _step_of(s, found, k.grip_step_after_s, k.grip_step)
    s.grip = k.adhesion_scale * (1.0 + step)
    if k.later_c1 > 0.0:
        at_s = s.braking_since_s + k.later_road_after_s
        if s.time_s >= at_s - SAME_TIME_S:
            s.road_c1, s.road_c2, s.road_c3 = k.later_c1, k.later_c2, k.later_c3
        else:
            s.road_c1, s.road_c2, s.road_c3 = k.road_c1, k.road_c2, k.road_c3
            change_s = min(change_s, at_s)
    return change_s


def _step_of(s: State, found: tuple[float, float, float], after_s: float, share: float) -> tuple[float, float, float]:
    """Return the latest of the steps that came and its time in s, and the next change's time in s; so is `found`."""
    at_s = s.braking_since_s + after_s
    if s.time_s < at_s - SAME_TIME_S:
        return found[0], found[1], min(found[2], at_s)
    if after_s >= found[1]:
        return share, after_s, found[2]
    return found


def _move(k: Constants, s: State, drive: float, duration_s: float) -> None:
    """Advance the wheels with a brake that settles to `settled_torque`; the caller advances the time."""
    if duration_s <= k.max_step_s and s.road_speed > duration_s * k.contact_rate / FOLLOWED:
        _step(k, s, drive, duration_s)  # one block, one cut
        return
    if s.wheel_speed == 0.0 == s.road_speed and _pull(k, drive, 0.0) <= k.M20:
        _take(k, s, duration_s, 0.0, 0.0)
        return
    blocks = math.ceil(duration_s / k.max_step_s - 1e-9)
    for _ in range(blocks):
        block_s = duration_s / blocks
        cuts = _cuts(k, s, block_s)
        for _ in range(cuts):
            _step(k, s, drive, block_s / cuts)


def _cuts(k: Constants, s: State, block_s: float) -> int:
    fastest = max(abs(s.wheel_speed), abs(s.road_speed))
    wanted, most = block_s * k.contact_rate / FOLLOWED, math.ceil(MOST_CUTS * block_s / k.max_step_s)
    return most if wanted >= most * fastest else math.ceil(wanted / fastest)


def _step(k: Constants, s: State, drive: float, h: float) -> None:
    x1, x2 = s.wheel_speed, s.road_speed
    if x2 < CRAWL_RAD_S and x1 < CRAWL_RAD_S and x2 > -CRAWL_RAD_S and x1 > -CRAWL_RAD_S:
        _crawl(k, s, drive, h)
        return
    next1, next2 = _next_speeds(k, s, drive, h)
    if x1 * next1 < 0.0 or x2 * next2 < 0.0:
        h -= _come_to_rest(k, s, drive, h, next1, next2)
        x1, x2 = s.wheel_speed, s.road_speed
        next1, next2 = _next_speeds(k, s, drive, h)
        next1 = next1 if x1 * next1 >= 0.0 else 0.0
        next2 = next2 if x2 * next2 >= 0.0 else 0.0
    _take(k, s, h, next1, next2)


def _crawl(k: Constants, s: State, drive: float, h: float) -> None:
    """Both wheels are almost at rest: they stick together, and move off together or not at all."""
    ratio = k.r2 / k.r1
    torque = _pull(k, drive, 0.0) - k.M20 - ratio * (k.M10 + s.brake_torque)
    next2 = s.road_speed + h * torque / (k.J2 + ratio * ratio * k.J1) if torque > 0.0 else 0.0
    _take(k, s, h, ratio * next2, next2)


def _come_to_rest(k: Constants, s: State, drive: float, h: float, next1: float, next2: float) -> float:
    """Advance to the instant in which the first wheel stops; return the elapsed time in s."""
    share1, share2 = _rest_share(s.wheel_speed, next1), _rest_share(s.road_speed, next2)
    crossed = h * min(share1, share2)
    next1, next2 = _next_speeds(k, s, drive, crossed)
    _take(k, s, crossed, 0.0 if share1 <= share2 else next1, next2 if share1 <= share2 else 0.0)
    return crossed


def _take(k: Constants, s: State, h: float, next1: float, next2: float) -> None:
    s.wheel_angle += 0.5 * h * (s.wheel_speed + next1)
    s.road_angle += 0.5 * h * (s.road_speed + next2)
    target = s.settled_torque
    if s.brake_torque != target:
        if h != s.lag_step_s:
            _brake_lag(k, s, h)
        s.brake_torque = target + (s.brake_torque - target) * s.lag_left
    s.wheel_speed, s.road_speed = next1, next2


def _pull(k: Constants, drive: float, road_speed: float) -> float:
    """The drive's torque in N m: switched off, it may still pull."""
    return drive_torque(k, drive, road_speed) if drive else k.drive_residual_nm


def _next_speeds(k: Constants, s: State, drive: float, h: float) -> tuple[float, float]:
    if k.load_ripple != 0.0:
        _press(k, s, h)
    x1, x2 = s.wheel_speed, s.road_speed
    torque, target = s.brake_torque, s.settled_torque
    if torque != target:
        # the exact mean over the step: the speeds follow the brake's impulse, however fast the brake is
        if h != s.lag_step_s:
            _brake_lag(k, s, h)
        torque = target + (torque - target) * s.lag_mean
    k1, k2, normal, traction, slip = rates(k, s, x1, x2, torque, _pull(k, drive, x2))
    stiff = h * k.contact_rate > STIFF * (max(x2, x1))
    if stiff:
        column1, column2, row1, row2 = contact_stiffness(k, s, x1, x2, normal, traction, slip)
        # on the falling side of the friction curve the contact is unstable but slow: damping it would be wrong
        damping = GAMMA * h / (1.0 - GAMMA * h * min(0.0, row1 * column1 + row2 * column2))
        along = damping * (row1 * k1 + row2 * k2)
        k1, k2 = k1 + along * column1, k2 + along * column2
    # friction keeps its sign within a step: a wheel that would reverse is almost at rest instead
    end1, end2 = x1 + h * k1, x2 + h * k2
    end1 = end1 if x1 * end1 >= 0.0 else x1 * ALMOST_AT_REST
    end2 = end2 if x2 * end2 >= 0.0 else x2 * ALMOST_AT_REST
    a1, a2, _, _, _ = rates(k, s, end1, end2, torque, _pull(k, drive, end2))
    a1 -= 2.0 * k1
    a2 -= 2.0 * k2
    if stiff:
        along = damping * (row1 * a1 + row2 * a2)
        a1, a2 = a1 + along * column1, a2 + along * column2
    return x1 + h * (1.5 * k1 + 0.5 * a1), x2 + h * (1.5 * k2 + 0.5 * a2)


def _press(k: Constants, s: State, h: float) -> None:
    """Use the normal force of the step's middle, which keeps the order."""
    angle = s.wheel_angle + 0.5 * h * s.wheel_speed
    load = 1.0 + k.load_ripple * elementary.sin(angle + k.load_ripple_phase_rad)
    s.L_sin, s.L_cos = k.L_sin / load, k.L_cos / load


def _brake_lag(k: Constants, s: State, h: float) -> None:
    rate = k.c31 * h if h > 0.0 else 0.0  # c31 may be infinite
    if k.brake_release_ratio != 1.0 and s.settled_torque < s.brake_torque:
        rate /= k.brake_release_ratio
    s.lag_step_s, s.lag_left = h, elementary.exp(-rate)
    s.lag_mean = (1.0 - s.lag_left) / rate if rate > 0.0 else 1.0


def _rest_share(speed: float, following: float) -> float:
    """Share of the step after which a wheel comes to rest, by a straight line; 1 if it does not."""
    return speed / (speed - following) if speed * following < 0.0 else 1.0
