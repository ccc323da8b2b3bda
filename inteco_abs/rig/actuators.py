"""Brake and drive motor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from inteco_abs.rig.parameters import RigParameters


def brake_torque(duty: float, parameters: RigParameters) -> float:
    """Torque in N m that the brake settles to at `duty` (0..1): b1*u + b2 from the dead zone's end u0 on, else 0."""
    if duty < parameters.u0:
        return 0.0
    return max(0.0, parameters.b1 * duty + parameters.b2)


def brake_duty(torque: float, parameters: RigParameters) -> float:
    """Duty that settles to `torque` in N m: the static map's inverse, 0 for no torque. May exceed 1."""
    if torque <= 0.0:
        return 0.0
    return (torque - parameters.b2) / parameters.b1


@dataclass(frozen=True, slots=True)
class DriveMotor:
    """The flat DC motor on the lower wheel: torque = stall * (duty - speed / no_load), never negative.

    ASSUMED: no drive motor data are published. A permanent-magnet motor fed by a one-quadrant chopper has this
    straight line; stall torque and no-load speed are chosen so that full duty reaches 180 rad/s in about 6 s, as
    in the manual's run-up plots (6.2 to 6.5 s to 1700 rpm with the start-up resistors), with the no-load speed
    above the over-speed limit of 245 rad/s so that the limit can be reached. The resistors' kink is not modelled.
    """

    stall_torque_nm: float = 1.72
    """Torque at standstill and full duty, N m."""
    no_load_speed_rad_s: float = 300.0
    """Speed at which full duty gives no torque, rad/s."""

    def torque(self, duty: float, road_speed: float) -> float:
        """Torque in N m at `duty` (0..1) and `road_speed` in rad/s; with no duty there is none, so it coasts."""
        return drive_torque(self, duty, road_speed)


class _Motor(Protocol):
    @property
    def stall_torque_nm(self) -> float: ...

    @property
    def no_load_speed_rad_s(self) -> float: ...


def drive_torque(k: _Motor, duty: float, road_speed: float) -> float:
    """`DriveMotor.torque` of any rig that has its two constants."""
    if duty <= 0.0:
        return 0.0
    return max(0.0, k.stall_torque_nm * (duty - road_speed / k.no_load_speed_rad_s))
