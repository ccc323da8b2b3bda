"""Kalman filter of angle, speed and acceleration for a wheel whose jerk is white noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

from inteco_abs import elementary
from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.angles import CountState, rad_per_count, turned
from inteco_abs.control.estimators.registry import EstimatorSpec, on_both_wheels, parameter
from inteco_abs.control.functions import Function

_SPEED_VARIANCE: Final = 25.0
_ACCELERATION_VARIANCE: Final = 1e4
"""Variances at the start, (rad/s)^2 and (rad/s2)^2: a wheel at rest that may be about to be driven."""


@dataclass(frozen=True, slots=True)
class KalmanConstants:
    """Noise of jerk and count."""

    per_count: float
    """rad"""
    density: float
    """rad2/s5"""
    noise: float
    """Variance of a count, rad2."""


@dataclass(slots=True)
class KalmanState(CountState):
    """Angle, speed and acceleration in rad and s, and the covariances `pij` of the states i and j."""

    th: float = 0.0
    v: float = 0.0
    a: float = 0.0
    p00: float = 0.0
    p01: float = 0.0
    p02: float = 0.0
    p11: float = _SPEED_VARIANCE
    p12: float = 0.0
    p22: float = _ACCELERATION_VARIANCE


def kalman(k: KalmanConstants, s: KalmanState, time_ns: int, count: int) -> float:
    """Speed in rad/s."""
    angle, dt_s = turned(k.per_count, s, time_ns, count)
    if dt_s > 0.0:
        _predict(k, s, dt_s)
    p00, p01, p02 = s.p00, s.p01, s.p02
    scale = 1.0 / (p00 + k.noise)
    k0, k1, k2 = p00 * scale, p01 * scale, p02 * scale
    e = angle - s.th
    s.th += k0 * e
    s.v = v = s.v + k1 * e
    s.a += k2 * e
    s.p00, s.p01, s.p02 = p00 - k0 * p00, p01 - k0 * p01, p02 - k0 * p02
    s.p11 -= k1 * p01
    s.p12 -= k1 * p02
    s.p22 -= k2 * p02
    return v


def _predict(k: KalmanConstants, s: KalmanState, T: float) -> None:
    v, a, half = s.v, s.a, 0.5 * T * T
    s.th, s.v = s.th + v * T + a * half, v + a * T
    p01, p02, p11, p12, p22 = s.p01, s.p02, s.p11, s.p12, s.p22
    s00, s01, s02 = s.p00 + T * p01 + half * p02, p01 + T * p11 + half * p12, p02 + T * p12 + half * p22
    s11, s12 = p11 + T * p12, p12 + T * p22
    q = k.density * T
    s.p00 = s00 + T * s01 + half * s02 + q * elementary.raised(T, 4) / 20.0
    s.p01 = s01 + T * s02 + q * elementary.raised(T, 3) / 8.0
    s.p02 = s02 + q * T * T / 6.0
    s.p11 = s11 + T * s12 + q * T * T / 3.0
    s.p12 = s12 + q * T / 2.0
    s.p22 = p22 + q


class KalmanFilter(KalmanState):
    """x' = (speed, acceleration, jerk), white jerk of the spectral density `jerk_density` in rad2/s5.

    The angle is measured, with the variance of a count that is rounded down, (2 pi/N)^2/12. No lag at constant
    acceleration, as in braking.
    """

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(kalman)

    def __init__(self, counts_per_turn: int, jerk_density: float) -> None:
        count = rad_per_count(counts_per_turn)
        super().__init__(p00=count * count)
        self.k = KalmanConstants(count, jerk_density, count * count / 12.0)

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s."""
        return kalman(self.k, self, time_ns, count)


def _kalman(config: RigConfig) -> KalmanFilter:
    return KalmanFilter(config.encoders.counts_per_turn, config.estimator.jerk_density)


SPEC: Final = EstimatorSpec(
    "Kalman filter of angle, speed and acceleration for a wheel whose jerk is white noise",
    (parameter("jerk_density", "rad2/s5", "quicker and noisier if higher"),),
    on_both_wheels(_kalman),
    KalmanFilter,
)
