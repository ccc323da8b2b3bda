"""Slip dynamics while braking, equations (9) to (17), and the reaching law's torque, equation (22).

Valid for a forward turning wheel that is slower at the rim than the road: s = s1 = s2 = 1.
"""

from __future__ import annotations

import math

from inteco_abs.rig import RigParameters, adhesion


class BrakingModel:
    """lam' = f(lam, x2) + g(lam, x2) * M1, with the constants c_ij of equation (10), signs included."""

    __slots__ = (
        "_cos",
        "_lever",
        "_ratio",
        "_sin",
        "c11",
        "c12",
        "c13",
        "c14",
        "c15",
        "c16",
        "c21",
        "c22",
        "c23",
        "c24",
        "c25",
        "parameters",
    )

    def __init__(self, parameters: RigParameters) -> None:
        k = parameters
        self.parameters = parameters
        self.c11 = k.r1 * k.d1 / k.J1
        self.c12 = (k.M10 + k.Mg) * k.r1 / k.J1
        self.c13 = -k.d1 / k.J1
        self.c14 = -k.M10 / k.J1
        self.c15 = k.r1 / k.J1
        self.c16 = -1.0 / k.J1
        self.c21 = -k.r2 * k.d1 / k.J2
        self.c22 = -(k.M10 + k.Mg) * k.r2 / k.J2
        self.c23 = -k.d2 / k.J2
        self.c24 = -k.M20 / k.J2
        self.c25 = -k.r2 / k.J2
        self._ratio = k.r1 / k.r2
        self._lever = k.L
        self._sin = math.sin(k.phi_rad)
        self._cos = math.cos(k.phi_rad)

    def S(self, slip: float) -> float:
        """Abbreviation of equation (10), in 1/m: mu / (L * (sin phi - mu * cos phi))."""
        mu = adhesion(slip, self.parameters)
        return mu / (self._lever * (self._sin - mu * self._cos))

    def f(self, slip: float, road_speed: float) -> float:
        """Equation (16), in 1/s; slip in 0..1, `road_speed` > 0 in rad/s."""
        return self.terms(slip, road_speed)[0]

    def g(self, slip: float, road_speed: float) -> float:
        """Equation (17), in 1/(s N m); slip in 0..1, `road_speed` > 0 in rad/s."""
        return self.terms(slip, road_speed)[1]

    def terms(self, slip: float, road_speed: float) -> tuple[float, float]:
        """Both terms, f in 1/s and g in 1/(s N m). Raises ValueError unless slip is in 0..1 and road speed above 0."""
        if not road_speed > 0.0:
            raise ValueError(f"road_speed = {road_speed!r} rad/s: must be above 0, f and g grow like 1/speed")
        S, rolling, ratio = self.S(slip), 1.0 - slip, self._ratio
        f = (
            -(S * self.c11 + self.c13) * rolling
            - ratio / road_speed * (S * self.c12 + self.c14)
            + rolling
            / road_speed
            * ((S * self.c21 / ratio * rolling + self.c23) * road_speed + S * self.c22 + self.c24)
        )
        g = -ratio / road_speed * (self.c15 * S + self.c16 - self.c25 * S * rolling / ratio)
        return f, g


def reaching_law_torque(
    slip: float, road_speed: float, reference: float, Mk: float, Mq: float, model: BrakingModel
) -> float:
    """Brake torque of the constant plus proportional reaching law, equation (22), in N m and before any limit.

    Gains in 1/s. On the switching surface itself sgn(0) = 0. Raises ValueError as `BrakingModel.terms` does.
    """
    f, g = model.terms(slip, road_speed)
    switching = slip - reference
    return -(f + Mk * switching + Mq * ((switching > 0.0) - (switching < 0.0))) / g


def reaching_time_bound(slip: float, reference: float, Mk: float, Mq: float) -> float:
    """Longest time in s from `slip` to `reference`, equation (20); gains in 1/s, above 0."""
    return math.log((Mk * abs(slip - reference) + Mq) / Mq) / Mk
