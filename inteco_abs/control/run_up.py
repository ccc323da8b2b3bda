"""Plausibility of the run-up: whether the road wheel gains speed as the drive motor can accelerate it.

All other checks of speed rest on the counts per turn. If both encoders have the same wrong scale they agree with each
other, but not with the acceleration of the wheels' inertia by the drive motor, which does not depend on an encoder.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from inteco_abs.config import RigConfig
from inteco_abs.rig import DriveMotor, RigParameters, nominal_drive_motor, nominal_parameters
from inteco_abs.signals import Command

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
_STRAIGHT_SHARE: Final = 2.0 / 3.0 / math.log(3.0)
"""Mean acceleration of a run-up to two thirds of its final speed, as a share of that from rest.

Start-up resistors, which drop out at some speed, make a run-up slower at first and so straighter: the vendor's plots
show a kink, and 1700 rpm after 6.2 to 6.5 s, a mean of 27 to 29 rad/s2. Two thirds of the published drive's final speed
are those 1700 rpm, and its mean is 30 rad/s2.
"""


class RunUp:
    """Compares the road wheel's mean speed over 0.1 s with the slowest and the fastest run-up that the drive may make.

    These are `factor` times slower and faster than the published drive's. Where a lab has identified its own drive,
    the square root of `factor` around that must hold as well; the published one always counts, as an identification
    with a wrong scale confirms that scale. A run-up begins with each new duty of at least a half; it is not checked
    while the brake acts.
    """

    def __init__(self, config: RigConfig, factor: float) -> None:
        model = config.model
        self._rigs = [_Rig(DriveMotor(), RigParameters.named(model.parameters), factor)]
        drive = nominal_drive_motor(model)
        if drive is not None:
            self._rigs.append(_Rig(drive, nominal_parameters(model), math.sqrt(factor)))
        self._bounds: list[_Bounds] = []
        self._angle_ns = 2.0 * math.pi / config.encoders.counts_per_turn * 1e9
        self._look_ns = round(max(_LOOK_S, _LOOK_PERIODS / config.loop.rate_hz) * 1e9)
        self._duty = 0.0
        self._then_ns = self._then_count = 0
        self._next_ns = 0
        self._looks = 0

    def plausible(self, now_ns: int, road_count: int, applied: Command) -> bool:
        """Whether the drive can make this run-up under the newest `applied` command; True while that is unknown."""
        duty, brake = applied
        if duty < _JUDGED_DUTY:
            self._duty = 0.0
            return True
        if duty != self._duty or brake >= _RELEASED_DUTY:
            self._duty, self._looks = duty, 0
            self._next_ns = now_ns + (_RELEASE_GRACE_NS if brake >= _RELEASED_DUTY else 0)
        if now_ns < self._next_ns:
            return True
        elapsed_ns, counts = now_ns - self._then_ns, road_count - self._then_count
        self._then_ns, self._then_count, self._next_ns = now_ns, road_count, now_ns + self._look_ns
        self._looks += 1
        if self._looks == 1:
            return True
        speed = counts * self._angle_ns / elapsed_ns
        if self._looks > _FIRST_SPEED:
            return all(bounds.allow(speed, elapsed_ns * 1e-9) for bounds in self._bounds)
        self._bounds = [rig.bounds(duty, speed) for rig in self._rigs]
        return True


class _Approach(NamedTuple):
    """First-order approach to the speed at which all torques balance."""

    end: float
    """That speed, rad/s."""
    lag_s: float

    def gain(self, speed: float, elapsed_s: float) -> float:
        """Gain in rad/s over a time that is short against the lag; 0 beyond the end."""
        return max(0.0, (self.end - speed) * elapsed_s / (self.lag_s + 0.5 * elapsed_s))


class _Rig:
    """A drive motor and both wheels rolling on each other."""

    def __init__(self, drive: DriveMotor, parameters: RigParameters, factor: float) -> None:
        ratio = parameters.r2 / parameters.r1
        self._drive = drive
        self._friction_nm = parameters.M20 + parameters.M10 * ratio
        self._drag = parameters.d2 + parameters.d1 * ratio * ratio
        self._inertia = parameters.J2 + parameters.J1 * ratio * ratio
        self._factor = factor

    def bounds(self, duty: float, speed: float) -> _Bounds:
        """Bounds of a run-up that continues from `speed` (rad/s) with `duty` of the drive."""
        stall, back = self._drive.stall_torque_nm, self._drive.stall_torque_nm / self._drive.no_load_speed_rad_s
        slow = self._approach(stall * duty - _MORE_FRICTION * self._friction_nm, back, self._factor)
        # with a chopper in discontinuous conduction the motor approaches its full speed at any duty
        fast = self._approach(stall * duty - _LESS_FRICTION * self._friction_nm, back * duty, 1.0 / self._factor)
        straight = _STRAIGHT_SHARE * (stall - self._friction_nm) / self._inertia * duty / self._factor
        return _Bounds(slow, fast, straight, speed)

    def _approach(self, torque_nm: float, back_nm: float, slower: float) -> _Approach:
        """Approach under `torque_nm` at rest, which falls by `back_nm` per rad/s and by the wheels' drag."""
        falling = back_nm + self._drag
        return _Approach(torque_nm / falling, self._inertia / falling * slower)


class _Bounds:
    """The slowest and the fastest possible run-up."""

    def __init__(self, slow: _Approach, fast: _Approach, straight_rad_s2: float, speed: float) -> None:
        self._slow, self._fast, self._straight = slow, fast, straight_rad_s2
        self._least = min(speed, slow.end)  # above the final speed a wheel slows down
        self._most = speed

    def allow(self, speed: float, elapsed_s: float) -> bool:
        """Whether `speed` (rad/s) is possible `elapsed_s` after the one before."""
        self._least += min(self._slow.gain(self._least, elapsed_s), self._straight * elapsed_s)
        self._most += self._fast.gain(self._most, elapsed_s)
        return self._least - _SLACK_RAD_S <= speed <= self._most + _SLACK_RAD_S
