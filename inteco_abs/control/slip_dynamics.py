"""Slip dynamics while braking, equations (9) to (17), and the reaching law's torque, equation (22).

Valid for a forward turning wheel that is slower at the rim than the road: s = s1 = s2 = 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from inteco_abs import elementary
from inteco_abs.rig import RigParameters, adhesion
from inteco_abs.rig.friction import formula, require_slip


@dataclass(frozen=True, slots=True)
class SlipConstants:
    """The constants c_ij of equation (10), signs included, and what equations (5) and (11) need."""

    c11: float
    c12: float
    c13: float
    c14: float
    c15: float
    c16: float
    c21: float
    c22: float
    c23: float
    c24: float
    c25: float
    ratio: float
    """r1/r2"""
    lever: float
    """L, in m."""
    sin: float
    """Sine of the lever's angle; `cos` is its cosine."""
    cos: float
    parameters: RigParameters


def slip_terms(k: SlipConstants, slip: float, road_speed: float) -> tuple[float, float]:
    """Return f and g as `BrakingModel.terms` does, unchecked."""
    mu = formula(k.parameters, slip)
    S, rolling, ratio = mu / (k.lever * (k.sin - mu * k.cos)), 1.0 - slip, k.ratio
    f = (
        -(S * k.c11 + k.c13) * rolling
        - ratio / road_speed * (S * k.c12 + k.c14)
        + rolling / road_speed * ((S * k.c21 / ratio * rolling + k.c23) * road_speed + S * k.c22 + k.c24)
    )
    g = -ratio / road_speed * (k.c15 * S + k.c16 - k.c25 * S * rolling / ratio)
    return f, g


class BrakingModel(SlipConstants):
    """lam' = f(lam, x2) + g(lam, x2) * M1, with the constants c_ij of equation (10), signs included."""

    __slots__ = ()

    def __init__(self, parameters: RigParameters) -> None:
        k = parameters
        sin, cos = elementary.sin_cos(k.phi_rad)
        super().__init__(
            c11=k.r1 * k.d1 / k.J1,
            c12=(k.M10 + k.Mg) * k.r1 / k.J1,
            c13=-k.d1 / k.J1,
            c14=-k.M10 / k.J1,
            c15=k.r1 / k.J1,
            c16=-1.0 / k.J1,
            c21=-k.r2 * k.d1 / k.J2,
            c22=-(k.M10 + k.Mg) * k.r2 / k.J2,
            c23=-k.d2 / k.J2,
            c24=-k.M20 / k.J2,
            c25=-k.r2 / k.J2,
            ratio=k.r1 / k.r2,
            lever=k.L,
            sin=sin,
            cos=cos,
            parameters=parameters,
        )

    def S(self, slip: float) -> float:
        """Abbreviation of equation (10), in 1/m: mu / (L * (sin phi - mu * cos phi))."""
        mu = adhesion(slip, self.parameters)
        return mu / (self.lever * (self.sin - mu * self.cos))

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
        require_slip(slip)
        return slip_terms(self, slip, road_speed)


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
    return elementary.log((Mk * abs(slip - reference) + Mq) / Mq) / Mk
