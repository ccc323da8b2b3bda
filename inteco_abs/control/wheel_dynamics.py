"""The two wheels while braking, equations (2), (3) and (5), for a given adhesion and brake torque.

`BrakingModel` has the slip dynamics in the paper's form with equation (8) inside; an observer needs the accelerations
for its own estimates of adhesion and torque, and their derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from inteco_abs import elementary
from inteco_abs.rig import RigParameters


class Accelerations(NamedTuple):
    """Accelerations of the wheels in rad/s2, and their derivatives by adhesion and brake torque."""

    wheel: float
    road: float
    wheel_per_adhesion: float
    road_per_adhesion: float
    wheel_per_nm: float
    """1/(kg m2)"""
    road_per_nm: float


@dataclass(frozen=True, slots=True)
class WheelConstants:
    """The rig, and its lever."""

    parameters: RigParameters
    sin: float
    """Lever's length times the sine of its angle, m."""
    cos: float


def accelerations(
    k: WheelConstants, wheel_speed: float, road_speed: float, torque: float, adhesion: float
) -> Accelerations:
    """At speeds in rad/s, with a brake torque in N m."""
    p, sin = k.parameters, k.sin
    r1, r2, J1, J2 = p.r1, p.r2, p.J1, p.J2
    lever = sin - k.cos * adhesion
    resisting = p.d1 * wheel_speed + torque + p.M10
    normal = (p.Mg + resisting) / lever  # (5)
    per_adhesion = normal * sin / lever  # the contact's force presses the lever down as well
    share = adhesion / lever  # of that force per N m of brake torque
    return Accelerations(
        (r1 * normal * adhesion - resisting) / J1,
        -(r2 * normal * adhesion + p.d2 * road_speed + p.M20) / J2,
        r1 * per_adhesion / J1,
        -r2 * per_adhesion / J2,
        (r1 * share - 1.0) / J1,
        -r2 * share / J2,
    )


def demanded_torque(
    k: WheelConstants, slip: float, slip_rate: float, wheel_speed: float, road_speed: float, adhesion: float
) -> tuple[float, float, float]:
    """Brake torque in N m for a `slip_rate` in 1/s, and its derivatives by rate and adhesion.

    (2) and (3) in lam' = ((1 - lam)*x2' - (r1/r2)*x1')/x2, the derivative of (11), are linear in the torque.
    """
    p = k.parameters
    lever = k.sin - k.cos * adhesion
    share = adhesion / lever
    inertia = p.J1 * p.r2 / p.r1
    rolling = inertia * (1.0 - slip) / p.J2
    per_resisting = 1.0 - share * (p.r1 + rolling * p.r2)
    slowing = rolling * (p.d2 * road_speed + p.M20)
    resisting = (inertia * slip_rate * road_speed + slowing + p.Mg * (1.0 - per_resisting)) / per_resisting
    pressing = (p.Mg + resisting) * (p.r1 + rolling * p.r2) * k.sin / elementary.raised(lever, 2)
    return (
        resisting - p.d1 * wheel_speed - p.M10,
        inertia * road_speed / per_resisting,
        pressing / per_resisting,
    )


class WheelDynamics(WheelConstants):
    """Forward turning wheels, the upper one slower at its rim: s = s1 = s2 = 1."""

    __slots__ = ()

    def __init__(self, parameters: RigParameters) -> None:
        sin, cos = elementary.sin_cos(parameters.phi_rad)
        super().__init__(parameters, parameters.L * sin, parameters.L * cos)

    def accelerations(self, wheel_speed: float, road_speed: float, torque: float, adhesion: float) -> Accelerations:
        """At speeds in rad/s, with a brake torque in N m."""
        return accelerations(self, wheel_speed, road_speed, torque, adhesion)

    def torque(
        self, slip: float, slip_rate: float, wheel_speed: float, road_speed: float, adhesion: float
    ) -> tuple[float, float, float]:
        """Brake torque in N m for a `slip_rate` in 1/s, and its derivatives by rate and adhesion."""
        return demanded_torque(self, slip, slip_rate, wheel_speed, road_speed, adhesion)
