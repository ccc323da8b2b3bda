"""The two wheels while braking, equations (2), (3) and (5), for a given adhesion and brake torque.

`BrakingModel` has the slip dynamics in the paper's form with equation (8) inside; an observer needs the accelerations
for its own estimates of adhesion and torque, and their derivatives.
"""

from __future__ import annotations

import math
from typing import NamedTuple

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


class WheelDynamics:
    """Forward turning wheels, the upper one slower at its rim: s = s1 = s2 = 1."""

    __slots__ = ("_cos", "_k", "_sin")

    def __init__(self, parameters: RigParameters) -> None:
        self._k = parameters
        self._sin = parameters.L * math.sin(parameters.phi_rad)
        self._cos = parameters.L * math.cos(parameters.phi_rad)

    def accelerations(self, wheel_speed: float, road_speed: float, torque: float, adhesion: float) -> Accelerations:
        """At speeds in rad/s, with a brake torque in N m."""
        k = self._k
        lever = self._sin - self._cos * adhesion
        resisting = k.d1 * wheel_speed + torque + k.M10
        normal = (k.Mg + resisting) / lever  # (5)
        per_adhesion = normal * self._sin / lever  # the contact's force presses the lever down as well
        share = adhesion / lever  # of that force per N m of brake torque
        return Accelerations(
            (k.r1 * normal * adhesion - resisting) / k.J1,
            -(k.r2 * normal * adhesion + k.d2 * road_speed + k.M20) / k.J2,
            k.r1 * per_adhesion / k.J1,
            -k.r2 * per_adhesion / k.J2,
            (k.r1 * share - 1.0) / k.J1,
            -k.r2 * share / k.J2,
        )

    def torque(
        self, slip: float, slip_rate: float, wheel_speed: float, road_speed: float, adhesion: float
    ) -> tuple[float, float, float]:
        """Brake torque in N m for a `slip_rate` in 1/s, and its derivatives by rate and adhesion.

        (2) and (3) in lam' = ((1 - lam)*x2' - (r1/r2)*x1')/x2, the derivative of (11), are linear in the torque.
        """
        k = self._k
        lever = self._sin - self._cos * adhesion
        share = adhesion / lever
        inertia = k.J1 * k.r2 / k.r1
        rolling = inertia * (1.0 - slip) / k.J2
        per_resisting = 1.0 - share * (k.r1 + rolling * k.r2)
        slowing = rolling * (k.d2 * road_speed + k.M20)
        resisting = (inertia * slip_rate * road_speed + slowing + k.Mg * (1.0 - per_resisting)) / per_resisting
        pressing = (k.Mg + resisting) * (k.r1 + rolling * k.r2) * self._sin / lever**2
        return (
            resisting - k.d1 * wheel_speed - k.M10,
            inertia * road_speed / per_resisting,
            pressing / per_resisting,
        )
