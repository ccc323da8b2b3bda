"""Plausibility of the run-up: whether the road wheel gains speed as the drive motor can accelerate it.

All other checks of speed rest on the counts per turn. If both encoders have the same wrong scale they agree with each
other, but not with the acceleration of the wheels' inertia by the drive motor, which does not depend on an encoder.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from inteco_abs import elementary
from inteco_abs.config import RigConfig
from inteco_abs.rig import DriveMotor, RigParameters, nominal_drive_motor, nominal_parameters

_JUDGED_DUTY: Final = 0.5
"""At lower duties the wheels reach at most half of the speed limit, and dry friction, of which little is known, is a
large part of the torque."""
_RELEASED_DUTY: Final = 0.01
_RELEASE_GRACE_NS: Final = 300_000_000
_LOOK_S: Final = 0.1
_LOOK_PERIODS: Final = 10
"""Shortest look in periods: a time stamp that is late by one period is then at most a tenth of the speed."""
_FIRST_SPEED: Final = 2
"""Looks that measure the speed at which a run-up begins."""
_SLACK_RAD_S: Final = 5.0
"""On both sides: for a drive that is a few ticks late, and the acceleration within a look."""
_MORE_FRICTION: Final = 1.5
_LESS_FRICTION: Final = 0.5
"""Factors on the static friction: the vendor's three measurements of M10 lie a factor of two apart."""
_STRAIGHT_SHARE: Final = 2.0 / 3.0 / elementary.log(3.0)
"""Mean acceleration of a run-up to two thirds of its final speed, as a share of that from rest.

Start-up resistors, which drop out at some speed, make a run-up slower at first and so straighter: the vendor's plots
show a kink, and 1700 rpm after 6.2 to 6.5 s, a mean of 27 to 29 rad/s2. Two thirds of the published drive's final speed
are those 1700 rpm, and its mean is 30 rad/s2.
"""


@dataclass(frozen=True, slots=True)
class DriveConstants:
    """A drive motor and both wheels rolling on each other."""

    stall_nm: float
    back_nm_s: float
    """Torque that the motor loses per rad/s."""
    friction_nm: float
    drag_nm_s: float
    inertia: float
    """Inertia of both wheels, seen from the road wheel, kg m2."""
    factor: float
    """How many times slower and faster than this drive a run-up may be."""


@dataclass(frozen=True, slots=True)
class RunUpConstants:
    """The published drive, and the one that the lab identified."""

    published: DriveConstants
    own: DriveConstants
    identified: bool
    """Whether the lab has identified its own drive."""
    angle_ns: float
    """Angle of one count, times 1e9."""
    look_ns: int


@dataclass(slots=True)
class Bounds:
    """The slowest and the fastest possible run-up: first-order approaches to speeds at which all torques balance."""

    slow_end: float = 0.0
    """Speed that the slowest run-up approaches, rad/s."""
    slow_lag_s: float = 0.0
    fast_end: float = 0.0
    fast_lag_s: float = 0.0
    straight: float = 0.0
    """Acceleration of the slowest straight run-up, rad/s2."""
    least: float = 0.0
    """Slowest speed that is possible now."""
    most: float = 0.0


@dataclass(slots=True)
class RunUpState:
    """The newest look, and the bounds since the second."""

    published: Bounds = field(default_factory=Bounds)
    own: Bounds = field(default_factory=Bounds)
    duty: float = 0.0
    then_ns: int = 0
    then_count: int = 0
    next_ns: int = 0
    looks: int = 0


def run_up_constants(config: RigConfig, factor: float) -> RunUpConstants:
    """The square root of `factor` holds for a drive that was identified."""
    model = config.model
    published = _drive_constants(DriveMotor(), RigParameters.named(model.parameters), factor)
    drive = nominal_drive_motor(model)
    own = None if drive is None else _drive_constants(drive, nominal_parameters(model), math.sqrt(factor))
    return RunUpConstants(
        published,
        own or published,
        own is not None,
        2.0 * math.pi / config.encoders.counts_per_turn * 1e9,
        round(max(_LOOK_S, _LOOK_PERIODS / config.loop.rate_hz) * 1e9),
    )


def _drive_constants(drive: DriveMotor, parameters: RigParameters, factor: float) -> DriveConstants:
    ratio = parameters.r2 / parameters.r1
    return DriveConstants(
        drive.stall_torque_nm,
        drive.stall_torque_nm / drive.no_load_speed_rad_s,
        parameters.M20 + parameters.M10 * ratio,
        parameters.d2 + parameters.d1 * ratio * ratio,
        parameters.J2 + parameters.J1 * ratio * ratio,
        factor,
    )


def plausible(k: RunUpConstants, s: RunUpState, now_ns: int, road_count: int, duty: float, brake: float) -> bool:
    """Whether the drive can make this run-up with `duty` of the drive and the `brake`; True while that is unknown.

    The road wheel's mean speed over 0.1 s is compared with the slowest and the fastest run-up that the drive may make:
    `factor` times slower and faster than the published drive's. Where a lab has identified its own drive, the square
    root of `factor` around that must hold as well; the published one always counts, as an identification with a wrong
    scale confirms that scale. A run-up begins with each new duty of at least a half; it is not checked while the brake
    acts.
    """
    if duty < _JUDGED_DUTY:
        s.duty = 0.0
        return True
    if duty != s.duty or brake >= _RELEASED_DUTY:
        s.duty, s.looks = duty, 0
        s.next_ns = now_ns + (_RELEASE_GRACE_NS if brake >= _RELEASED_DUTY else 0)
    if now_ns < s.next_ns:
        return True
    elapsed_ns, counts = now_ns - s.then_ns, road_count - s.then_count
    s.then_ns, s.then_count, s.next_ns = now_ns, road_count, now_ns + k.look_ns
    s.looks += 1
    if s.looks == 1:
        return True
    speed = counts * k.angle_ns / elapsed_ns
    if s.looks > _FIRST_SPEED:
        elapsed_s = elapsed_ns * 1e-9
        return _allow(s.published, speed, elapsed_s) and (not k.identified or _allow(s.own, speed, elapsed_s))
    _begin(k.published, s.published, duty, speed)
    _begin(k.own, s.own, duty, speed)
    return True


def _begin(k: DriveConstants, s: Bounds, duty: float, speed: float) -> None:
    """Bounds of a run-up that continues from `speed` (rad/s) with `duty` of the drive."""
    falling = k.back_nm_s + k.drag_nm_s
    s.slow_end = (k.stall_nm * duty - _MORE_FRICTION * k.friction_nm) / falling
    s.slow_lag_s = k.inertia / falling * k.factor
    # with a chopper in discontinuous conduction the motor approaches its full speed at any duty
    falling = k.back_nm_s * duty + k.drag_nm_s
    s.fast_end = (k.stall_nm * duty - _LESS_FRICTION * k.friction_nm) / falling
    s.fast_lag_s = k.inertia / falling * (1.0 / k.factor)
    s.straight = _STRAIGHT_SHARE * (k.stall_nm - k.friction_nm) / k.inertia * duty / k.factor
    s.least = min(speed, s.slow_end)  # above the final speed a wheel slows down
    s.most = speed


def _allow(s: Bounds, speed: float, elapsed_s: float) -> bool:
    """Whether `speed` (rad/s) is possible `elapsed_s` after the one before."""
    s.least += min(_gain(s.slow_end, s.slow_lag_s, s.least, elapsed_s), s.straight * elapsed_s)
    s.most += _gain(s.fast_end, s.fast_lag_s, s.most, elapsed_s)
    return s.least - _SLACK_RAD_S <= speed <= s.most + _SLACK_RAD_S


def _gain(end: float, lag_s: float, speed: float, elapsed_s: float) -> float:
    """Gain in rad/s over a time that is short against the lag; 0 beyond the end."""
    return max(0.0, (end - speed) * elapsed_s / (lag_s + 0.5 * elapsed_s))
