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

from inteco_abs.rig.actuators import DriveMotor, brake_torque
from inteco_abs.rig.adhesion_curve import AdhesionCurve
from inteco_abs.rig.brake_actuator import SAME_TIME_S, BrakeActuator
from inteco_abs.rig.model import Model, wheel_slip
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.variation import RigVariation

GAMMA: Final = 1.0 - math.sqrt(0.5)
CONTACT_RATE: Final = 15.6e3
"""Largest contact eigenvalue times the speed, rad/s2, of both published sets."""
STIFF: Final = 0.25
"""Step times eigenvalue from which the contact is solved implicitly."""
FOLLOWED: Final = 0.5
"""Largest step times eigenvalue, as long as `MOST_CUTS` allows."""
MOST_CUTS: Final = 64
ALMOST_AT_REST: Final = 1e-9
CRAWL_RAD_S: Final = 0.005
"""Below this the slip has no meaning: static friction stops it within 2 ms, an encoder counts once in 0.6 s."""


class Plant:
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
        self.wheel_speed = wheel_speed
        self.road_speed = road_speed
        self.brake_torque = 0.0
        self.wheel_angle = 0.0
        self.road_angle = 0.0
        self.time_s = 0.0
        self._max_step_s = max_step_s
        self._variation = variation
        self._plain = variation.plain_plant
        self._surface = AdhesionCurve(variation.adhesion_scale, variation.adhesion_blend)
        self._model = Model(self.parameters, None if self._plain else self._surface)
        self._rates = self._model.rates
        self._brake = BrakeActuator(variation)
        self._ripple = variation.load_ripple
        self._braking_since_s = math.inf
        # a step in s; the share of the brake's distance to its target after it, and its mean over it
        self._lag = (math.nan, 0.0, 0.0)

    @property
    def slip(self) -> float:
        """Slip in 0..1, equation (7)."""
        return wheel_slip(self.wheel_speed, self.road_speed, self.parameters)

    @property
    def adhesion(self) -> float:
        """Adhesion coefficient of the road at this slip, equation (8) or the rig's own."""
        return self._surface.adhesion(self.slip, self.parameters)

    def advance(self, drive: float, brake: float, duration_s: float) -> None:
        """Advance by `duration_s` >= 0 with constant duties in 0..1; raises ValueError outside."""
        if not (0.0 <= drive <= 1.0 and 0.0 <= brake <= 1.0):
            raise ValueError(f"drive {drive!r}, brake {brake!r}: duties must be in 0..1")
        if not 0.0 <= duration_s < math.inf:
            raise ValueError(f"duration_s = {duration_s!r}: must be finite and not negative")
        if self._plain:
            self._move(drive, brake_torque(brake, self.parameters), duration_s)
            self.time_s += duration_s
        else:
            self._move_in_parts(drive, brake, duration_s)

    def _move_in_parts(self, drive: float, brake: float, duration_s: float) -> None:
        """Advance in parts that end where a delayed command acts or the road's adhesion steps."""
        self._brake.command(self.time_s, brake)
        if drive > 0.0:
            self._braking_since_s = math.inf
        elif brake > 0.0:
            self._braking_since_s = min(self._braking_since_s, self.time_s)
        step_s = self._braking_since_s + self._variation.grip_step_after_s
        left_s = duration_s
        while True:
            arrival_s = self._brake.move_to(self.time_s)
            stepped = self.time_s >= step_s - SAME_TIME_S
            self._surface.grip = 1.0 + self._variation.grip_step if stepped else 1.0
            part_s = min(left_s, (arrival_s if stepped else min(arrival_s, step_s)) - self.time_s)
            self._move(drive, self._brake.settled_torque, part_s)
            self.time_s += part_s
            if part_s == left_s:
                break
            left_s -= part_s

    def _move(self, drive: float, target: float, duration_s: float) -> None:
        """Advance the wheels with a brake that settles to `target`, in N m; the caller advances the time."""
        if duration_s <= self._max_step_s and self.road_speed > duration_s * CONTACT_RATE / FOLLOWED:
            self._step(drive, target, duration_s)  # one block, one cut
            return
        if self.wheel_speed == 0.0 == self.road_speed and not self._breaks_away(drive):
            self._take(duration_s, target, 0.0, 0.0)
            return
        blocks = math.ceil(duration_s / self._max_step_s - 1e-9)
        for _ in range(blocks):
            block_s = duration_s / blocks
            cuts = self._cuts(block_s)
            for _ in range(cuts):
                self._step(drive, target, block_s / cuts)

    def _cuts(self, block_s: float) -> int:
        fastest = max(abs(self.wheel_speed), abs(self.road_speed))
        wanted = block_s * CONTACT_RATE / FOLLOWED
        return MOST_CUTS if wanted >= MOST_CUTS * fastest else math.ceil(wanted / fastest)

    def _breaks_away(self, drive: float) -> bool:
        """Whether the drive overcomes the static friction of a road wheel at rest."""
        return self.motor.torque(drive, 0.0) > self.parameters.M20

    def _step(self, drive: float, target: float, h: float) -> None:
        x1, x2 = self.wheel_speed, self.road_speed
        if x2 < CRAWL_RAD_S and x1 < CRAWL_RAD_S and x2 > -CRAWL_RAD_S and x1 > -CRAWL_RAD_S:
            self._crawl(drive, target, h)
            return
        next1, next2 = self._next_speeds(drive, target, h)
        if x1 * next1 < 0.0 or x2 * next2 < 0.0:
            h -= self._come_to_rest(drive, target, h, next1, next2)
            x1, x2 = self.wheel_speed, self.road_speed
            next1, next2 = self._next_speeds(drive, target, h)
            next1 = next1 if x1 * next1 >= 0.0 else 0.0
            next2 = next2 if x2 * next2 >= 0.0 else 0.0
        self._take(h, target, next1, next2)

    def _crawl(self, drive: float, target: float, h: float) -> None:
        """Both wheels are almost at rest: they stick together, and move off together or not at all."""
        k = self.parameters
        ratio = k.r2 / k.r1
        torque = self.motor.torque(drive, 0.0) - k.M20 - ratio * (k.M10 + self.brake_torque)
        next2 = self.road_speed + h * torque / (k.J2 + ratio**2 * k.J1) if torque > 0.0 else 0.0
        self._take(h, target, ratio * next2, next2)

    def _come_to_rest(self, drive: float, target: float, h: float, next1: float, next2: float) -> float:
        """Advance to the instant in which the first wheel stops; return the elapsed time in s."""
        share1, share2 = _rest_share(self.wheel_speed, next1), _rest_share(self.road_speed, next2)
        crossed = h * min(share1, share2)
        next1, next2 = self._next_speeds(drive, target, crossed)
        self._take(crossed, target, *((0.0, next2) if share1 <= share2 else (next1, 0.0)))
        return crossed

    def _take(self, h: float, target: float, next1: float, next2: float) -> None:
        self.wheel_angle += 0.5 * h * (self.wheel_speed + next1)
        self.road_angle += 0.5 * h * (self.road_speed + next2)
        if self.brake_torque != target:
            lag = self._lag if h == self._lag[0] else self._brake_lag(h)
            self.brake_torque = target + (self.brake_torque - target) * lag[1]
        self.wheel_speed, self.road_speed = next1, next2

    def _next_speeds(self, drive: float, target: float, h: float) -> tuple[float, float]:
        if self._ripple:
            self._press(h)
        rates, motor = self._rates, self.motor.torque
        x1, x2 = self.wheel_speed, self.road_speed
        torque = self.brake_torque
        if torque != target:
            # the exact mean over the step: the speeds follow the brake's impulse, however fast the brake is
            lag = self._lag if h == self._lag[0] else self._brake_lag(h)
            torque = target + (torque - target) * lag[2]
        k1, k2, normal, traction, slip = rates(x1, x2, torque, motor(drive, x2) if drive else 0.0)
        stiff = h * CONTACT_RATE > STIFF * (max(x2, x1))
        if stiff:
            column1, column2, row1, row2 = self._model.contact_stiffness(x1, x2, normal, traction, slip)
            # on the falling side of the friction curve the contact is unstable but slow: damping it would be wrong
            damping = GAMMA * h / (1.0 - GAMMA * h * min(0.0, row1 * column1 + row2 * column2))
            along = damping * (row1 * k1 + row2 * k2)
            k1, k2 = k1 + along * column1, k2 + along * column2
        # friction keeps its sign within a step: a wheel that would reverse is almost at rest instead
        end1, end2 = x1 + h * k1, x2 + h * k2
        end1 = end1 if x1 * end1 >= 0.0 else x1 * ALMOST_AT_REST
        end2 = end2 if x2 * end2 >= 0.0 else x2 * ALMOST_AT_REST
        a1, a2, _, _, _ = rates(end1, end2, torque, motor(drive, end2) if drive else 0.0)
        a1 -= 2.0 * k1
        a2 -= 2.0 * k2
        if stiff:
            along = damping * (row1 * a1 + row2 * a2)
            a1, a2 = a1 + along * column1, a2 + along * column2
        return x1 + h * (1.5 * k1 + 0.5 * a1), x2 + h * (1.5 * k2 + 0.5 * a2)

    def _press(self, h: float) -> None:
        """Use the normal force of the step's middle, which keeps the order."""
        angle = self.wheel_angle + 0.5 * h * self.wheel_speed
        self._model.press(1.0 + self._ripple * math.sin(angle + self._variation.load_ripple_phase_rad))

    def _brake_lag(self, h: float) -> tuple[float, float, float]:
        rate = self.parameters.c31 * h if h > 0.0 else 0.0  # c31 may be infinite
        left = math.exp(-rate)
        self._lag = (h, left, (1.0 - left) / rate if rate > 0.0 else 1.0)
        return self._lag


def _rest_share(speed: float, following: float) -> float:
    """Share of the step after which a wheel comes to rest, by a straight line; 1 if it does not."""
    return speed / (speed - following) if speed * following < 0.0 else 1.0
