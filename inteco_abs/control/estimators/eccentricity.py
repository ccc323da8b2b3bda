"""One wheel between brakings, and the error of its encoder's disc once per turn."""

from __future__ import annotations

import math
from typing import Final

_SPEED_SD: Final = 200.0
_ACCELERATION_SD: Final = 50.0
"""Standard deviations before the first count, in rad/s and rad/s2: any speed and acceleration of the rig."""
_WAVE_SD_COUNTS: Final = 0.6
"""Of the prior: a disc is about half a count off centre."""
_JERK_DENSITY: Final = 1e3
"""White jerk in rad2/s5 of a wheel that is driven or coasts."""
_LEARNING_RAD_S: Final = 60.0
"""Speed above which a turn is short enough to separate the disc from the motion."""


class EccentricityFilter:
    """Kalman filter of angle, speed and acceleration, and of the error that a disc off centre adds to the angle.

    z = th + c*cos(z) + s*sin(z) + noise, th''' white; the noise `noise_rad` is that of a count. Once c and s are
    learnt, the error is known in any later braking as well.
    """

    __slots__ = ("_P", "_noise", "_x")

    def __init__(self, count_rad: float, noise_rad: float) -> None:
        wave = (_WAVE_SD_COUNTS * count_rad) ** 2
        self._noise = noise_rad**2
        self._x = [0.0] * 5
        self._P = [[0.0] * 5 for _ in range(5)]
        self._P[3][3] = self._P[4][4] = wave
        self.restart(0.0)

    @property
    def angle(self) -> float:
        """In rad, without the disc's error."""
        return self._x[0]

    @property
    def speed(self) -> float:
        """In rad/s."""
        return self._x[1]

    @property
    def spread(self) -> tuple[float, float, float]:
        """Variances of angle and speed, and their covariance."""
        return self._P[0][0], self._P[1][1], self._P[0][1]

    def restart(self, angle: float, speed: float = 0.0, deviation: float = _SPEED_SD) -> None:
        """Restart at `angle` in rad and `speed` with its `deviation` in rad/s; what was learnt of the disc is kept."""
        self._x[:3] = [self.straight(angle), speed, 0.0]
        for i, variance in enumerate((self._noise, deviation**2, _ACCELERATION_SD**2)):
            self._P[i] = [0.0] * 5
            self._P[i][i] = variance
        for i in (3, 4):
            self._P[i][:3] = [0.0] * 3

    def straight(self, angle: float) -> float:
        """The wheel's angle, from the disc's `angle`, in rad."""
        return angle - self._x[3] * math.cos(angle) - self._x[4] * math.sin(angle)

    def update(self, angle: float, dt_s: float) -> None:
        """Advance by `dt_s`, and correct by the disc's `angle` in rad."""
        if dt_s > 0.0:
            self._predict(dt_s)
        quick = self._x[1] > _LEARNING_RAD_S
        cosine, sine = (math.cos(angle), math.sin(angle)) if quick else (0.0, 0.0)
        P, x = self._P, self._x
        expected = [row[0] + cosine * row[3] + sine * row[4] for row in P]
        variance = expected[0] + cosine * expected[3] + sine * expected[4] + self._noise
        error = (angle - x[0] - cosine * x[3] - sine * x[4]) / variance
        self._x = [value + e * error for value, e in zip(x, expected, strict=True)]
        for i, row in enumerate(P):
            gain = expected[i] / variance
            P[i] = [value - gain * e for value, e in zip(row, expected, strict=True)]

    def _predict(self, T: float) -> None:
        half = 0.5 * T * T
        th, v, a, *wave = self._x
        self._x = [th + v * T + a * half, v + a * T, a, *wave]
        carried = [[r[0] + T * r[1] + half * r[2], r[1] + T * r[2], r[2], r[3], r[4]] for r in self._P]
        angle, speed, acceleration, *rest = carried
        P = self._P
        P[0] = [p + T * q + half * r for p, q, r in zip(angle, speed, acceleration, strict=True)]
        P[1] = [q + T * r for q, r in zip(speed, acceleration, strict=True)]
        P[2], P[3], P[4] = acceleration, *rest
        P[2][2] += _JERK_DENSITY * T
