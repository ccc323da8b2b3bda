"""Kalman filter of angle, speed and acceleration for a wheel whose jerk is white noise."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.base import Angles
from inteco_abs.control.estimators.registry import EstimatorSpec, on_both_wheels, parameter

_SPEED_VARIANCE: Final = 25.0
_ACCELERATION_VARIANCE: Final = 1e4
"""At the start, (rad/s)^2 and (rad/s2)^2: a wheel at rest that may be about to be driven."""


class KalmanFilter:
    """x' = (speed, acceleration, jerk), white jerk of the spectral density `jerk_density` in rad2/s5.

    The angle is measured, with the variance of a count that is rounded down, (2 pi/N)^2/12. No lag at constant
    acceleration, as in braking.
    """

    __slots__ = ("_angles", "_density", "_noise", "_p", "_x")

    def __init__(self, counts_per_turn: int, jerk_density: float) -> None:
        count = 2.0 * math.pi / counts_per_turn
        self._angles = Angles(counts_per_turn)
        self._density = jerk_density
        self._noise = count * count / 12.0
        self._x = 0.0, 0.0, 0.0
        # covariances: angle-angle, angle-speed, angle-acceleration, speed-speed, speed-acceleration, acceleration
        self._p = count * count, 0.0, 0.0, _SPEED_VARIANCE, 0.0, _ACCELERATION_VARIANCE

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s."""
        angle, dt_s = self._angles.update(time_ns, count)
        if dt_s > 0.0:
            self._predict(dt_s)
        return self._correct(angle)

    def _predict(self, T: float) -> None:
        th, v, a = self._x
        half = 0.5 * T * T
        self._x = th + v * T + a * half, v + a * T, a
        p00, p01, p02, p11, p12, p22 = self._p
        s00, s01, s02 = p00 + T * p01 + half * p02, p01 + T * p11 + half * p12, p02 + T * p12 + half * p22
        s11, s12 = p11 + T * p12, p12 + T * p22
        q = self._density * T
        self._p = (
            s00 + T * s01 + half * s02 + q * T**4 / 20.0,
            s01 + T * s02 + q * T**3 / 8.0,
            s02 + q * T * T / 6.0,
            s11 + T * s12 + q * T * T / 3.0,
            s12 + q * T / 2.0,
            p22 + q,
        )

    def _correct(self, angle: float) -> float:
        p00, p01, p02, p11, p12, p22 = self._p
        scale = 1.0 / (p00 + self._noise)
        k0, k1, k2 = p00 * scale, p01 * scale, p02 * scale
        th, v, a = self._x
        e = angle - th
        self._x = th + k0 * e, v + k1 * e, a + k2 * e
        self._p = p00 - k0 * p00, p01 - k0 * p01, p02 - k0 * p02, p11 - k1 * p01, p12 - k1 * p02, p22 - k2 * p02
        return self._x[1]


def _kalman(config: RigConfig) -> KalmanFilter:
    return KalmanFilter(config.encoders.counts_per_turn, config.estimator.jerk_density)


SPEC: Final = EstimatorSpec(
    "Kalman filter of angle, speed and acceleration for a wheel whose jerk is white noise",
    (parameter("jerk_density", "rad2/s5", "quicker and noisier if higher"),),
    on_both_wheels(_kalman),
    KalmanFilter,
)
