"""Sliding mode laws by their reaching law: the paper's, and those it is compared with."""

from __future__ import annotations

import math
from typing import Any, ClassVar

from inteco_abs import elementary
from inteco_abs.control.controllers.base import LAG, Gain, LawState, ModelLaw, law, saturated, sign
from inteco_abs.control.functions import Function

_MK = Gain("Mk", 2.0, 0.0, 1000.0, "1/s", "proportional rate: shortens the reaching phase")


# each rate takes what the one that needs most takes: constants, state, slip error, road speed and time
def _constant_plus_proportional(k: Any, _s: LawState, switching: float, _road_speed: float, _dt_s: float) -> float:
    rate: float = k.Mk * switching + k.Mq * sign(switching)
    return rate


def _constant(k: Any, _s: LawState, switching: float, _road_speed: float, _dt_s: float) -> float:
    rate: float = k.Mq * sign(switching)
    return rate


def _power(k: Any, _s: LawState, switching: float, _road_speed: float, _dt_s: float) -> float:
    rate: float = k.K * math.copysign(elementary.power(abs(switching), k.alpha), switching)
    return rate


def _exponential(k: Any, _s: LawState, switching: float, _road_speed: float, _dt_s: float) -> float:
    near = elementary.exp(-k.a * elementary.power(abs(switching), k.p))
    rate: float = k.K / (k.d + (1.0 - k.d) * near) * sign(switching)
    return rate


def _with_boundary_layer(k: Any, s: LawState, switching: float, road_speed: float, dt_s: float) -> float:
    if not saturated(k, s):
        s.integral += switching * dt_s
    share = max(-1.0, min(1.0, switching / k.width))
    grown = max(1.0, k.v / road_speed)
    rate: float = k.Mk * switching + k.Mq * grown * share + k.Ki * s.integral
    return rate


def _super_twisting(k: Any, s: LawState, switching: float, _road_speed: float, dt_s: float) -> float:
    if not saturated(k, s):
        s.integral += k.k2 * sign(switching) * dt_s
    rate: float = k.k1 * math.copysign(math.sqrt(abs(switching)), switching) + s.integral
    return rate


class ReachingLaw(ModelLaw):
    """The paper's law, constant plus proportional: s' = -Mk*s - Mq*sgn(s), equations (18) to (22)."""

    gains: ClassVar[tuple[Gain, ...]] = (
        _MK,
        Gain("Mq", 1.0, 0.0, 1000.0, "1/s", "constant rate: rejects model error, as small as possible"),
        LAG,
    )
    function: ClassVar[Function] = law(_constant_plus_proportional)


class ConstantRate(ModelLaw):
    """Conventional sliding mode control, which the paper compares with: s' = -Mq*sgn(s)."""

    gains: ClassVar[tuple[Gain, ...]] = (Gain("Mq", 1.0, 0.0, 1000.0, "1/s", "constant rate"), LAG)
    function: ClassVar[Function] = law(_constant)


class PowerRate(ModelLaw):
    """Power-rate reaching (Gao and Hung 1993): s' = -K*|s|^alpha*sgn(s), gentle near the surface."""

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("K", 3.0, 0.0, 1000.0, "1/s", "rate at an error of 1"),
        Gain("alpha", 0.5, 0.01, 1.0, "1", "1 is proportional, towards 0 constant rate"),
        LAG,
    )
    function: ClassVar[Function] = law(_power)


class ExponentialRate(ModelLaw):
    """Exponential reaching (Fallaha et al. 2011): s' = -K/N(s)*sgn(s), N = d + (1 - d)*exp(-a*|s|^p).

    The rate is K/d far from the surface and K on it: fast reaching with little chattering.
    """

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("K", 0.5, 0.0, 1000.0, "1/s", "rate on the surface"),
        Gain("d", 0.2, 0.01, 1.0, "1", "the rate far away is K/d"),
        Gain("a", 20.0, 0.0, 1000.0, "1", "how quickly the rate grows with the error"),
        Gain("p", 1.0, 0.1, 5.0, "1", "exponent of the error in N"),
        LAG,
    )
    function: ClassVar[Function] = law(_exponential)


class BoundaryLayer(ModelLaw):
    """The paper's law with a boundary layer, a switching gain that grows with the uncertainty, and an integral.

    s' = -Mk*s - Mq*(v/x2)*sat(s/width) - Ki*integral(s). Model errors grow as 1/x2, and so does the switching gain;
    the integral is held while the brake is at its limits.
    """

    gains: ClassVar[tuple[Gain, ...]] = (
        _MK,
        Gain("Mq", 1.0, 0.0, 1000.0, "1/s", "switching rate at the road speed v"),
        Gain("v", 0.0, 0.0, 245.0, "rad/s", "the switching rate grows as v/x2 below it; 0: it is constant"),
        Gain("width", 0.02, 1e-6, 1.0, "1", "slip error at which the switching term is full"),
        Gain("Ki", 0.0, 0.0, 10_000.0, "1/s2", "integral rate"),
        LAG,
    )
    function: ClassVar[Function] = law(_with_boundary_layer)


class SuperTwisting(ModelLaw):
    """Super-twisting (Levant 1993): s' = -k1*sqrt(|s|)*sgn(s) - w, w' = k2*sgn(s); a continuous torque."""

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("k1", 2.0, 0.0, 1000.0, "1/s", "root term"),
        Gain("k2", 2.0, 0.0, 10_000.0, "1/s2", "integral of the sign, held while the brake is at its limits"),
        LAG,
    )
    function: ClassVar[Function] = law(_super_twisting)
