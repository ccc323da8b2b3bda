"""Sliding mode laws by their reaching law: the paper's, and those it is compared with."""

from __future__ import annotations

import math
from typing import ClassVar

from inteco_abs.control.controllers.base import LAG, Gain, ModelLaw, Setup, sign

_MK = Gain("Mk", 2.0, 0.0, 1000.0, "1/s", "proportional rate: shortens the reaching phase")


class ReachingLaw(ModelLaw):
    """The paper's law, constant plus proportional: s' = -Mk*s - Mq*sgn(s), equations (18) to (22)."""

    gains: ClassVar[tuple[Gain, ...]] = (
        _MK,
        Gain("Mq", 1.0, 0.0, 1000.0, "1/s", "constant rate: rejects model error, as small as possible"),
        LAG,
    )

    def __init__(self, setup: Setup, Mk: float, Mq: float, lag_s: float = 0.0) -> None:
        super().__init__(setup, lag_s)
        self._Mk = Mk
        self._Mq = Mq

    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:  # noqa: ARG002  a static law
        return self._Mk * switching + self._Mq * sign(switching)


class ConstantRate(ModelLaw):
    """Conventional sliding mode control, which the paper compares with: s' = -Mq*sgn(s)."""

    gains: ClassVar[tuple[Gain, ...]] = (Gain("Mq", 1.0, 0.0, 1000.0, "1/s", "constant rate"), LAG)

    def __init__(self, setup: Setup, Mq: float, lag_s: float = 0.0) -> None:
        super().__init__(setup, lag_s)
        self._Mq = Mq

    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:  # noqa: ARG002  a static law
        return self._Mq * sign(switching)


class PowerRate(ModelLaw):
    """Power-rate reaching (Gao and Hung 1993): s' = -K*|s|^alpha*sgn(s), gentle near the surface."""

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("K", 3.0, 0.0, 1000.0, "1/s", "rate at an error of 1"),
        Gain("alpha", 0.5, 0.01, 1.0, "1", "1 is proportional, towards 0 constant rate"),
        LAG,
    )

    def __init__(self, setup: Setup, K: float, alpha: float, lag_s: float = 0.0) -> None:
        super().__init__(setup, lag_s)
        self._K = K
        self._alpha = alpha

    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:  # noqa: ARG002  a static law
        return self._K * math.copysign(abs(switching) ** self._alpha, switching)


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

    def __init__(self, setup: Setup, K: float, d: float, a: float, p: float, lag_s: float = 0.0) -> None:
        super().__init__(setup, lag_s)
        self._K = K
        self._d = d
        self._a = a
        self._p = p

    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:  # noqa: ARG002  a static law
        near = math.exp(-self._a * abs(switching) ** self._p)
        return self._K / (self._d + (1.0 - self._d) * near) * sign(switching)


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

    def __init__(
        self, setup: Setup, Mk: float, Mq: float, v: float, width: float, Ki: float, lag_s: float = 0.0
    ) -> None:
        super().__init__(setup, lag_s)
        self._Mk = Mk
        self._Mq = Mq
        self._v = v
        self._width = width
        self._Ki = Ki
        self._integral = 0.0

    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:
        if not self._saturated:
            self._integral += switching * dt_s
        share = max(-1.0, min(1.0, switching / self._width))
        grown = max(1.0, self._v / road_speed)
        return self._Mk * switching + self._Mq * grown * share + self._Ki * self._integral


class SuperTwisting(ModelLaw):
    """Super-twisting (Levant 1993): s' = -k1*sqrt(|s|)*sgn(s) - w, w' = k2*sgn(s); a continuous torque."""

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("k1", 2.0, 0.0, 1000.0, "1/s", "root term"),
        Gain("k2", 2.0, 0.0, 10_000.0, "1/s2", "integral of the sign, held while the brake is at its limits"),
        LAG,
    )

    def __init__(self, setup: Setup, k1: float, k2: float, lag_s: float = 0.0) -> None:
        super().__init__(setup, lag_s)
        self._k1 = k1
        self._k2 = k2
        self._w = 0.0

    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:  # noqa: ARG002  its own schedule
        if not self._saturated:
            self._w += self._k2 * sign(switching) * dt_s
        return self._k1 * math.copysign(math.sqrt(abs(switching)), switching) + self._w
