"""A Kalman filter for each wheel: angle, speed and acceleration, driven by white jerk."""

from math import pi

import numpy as np

from inteco_abs.signals import Estimate

JERK = 1.0e5  # spectral density, rad2/s5
COUNTS = 0.55  # standard deviation of a reading: rounding down, jitter and the disc


class Speed:
    """Speed of one wheel from its counts, by the filter's stationary gain."""

    def __init__(self, counts_per_turn, period_s):
        self.rad_per_count, T = 2.0 * pi / counts_per_turn, period_s
        F = np.array([[1.0, T, T * T / 2.0], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
        Q = JERK * np.array(
            [
                [T**5 / 20.0, T**4 / 8.0, T**3 / 6.0],
                [T**4 / 8.0, T**3 / 3.0, T**2 / 2.0],
                [T**3 / 6.0, T**2 / 2.0, T],
            ]
        )
        P, R = np.diag([1.0, 1e4, 1e6]), (COUNTS * self.rad_per_count) ** 2
        self.gains = []
        for _ in range(2000):  # the first ones bring the filter in quickly, the last one stays
            P = F @ P @ F.T + Q
            gain = P[:, 0] / (P[0, 0] + R)
            P -= np.outer(gain, P[0])
            self.gains.append(tuple(gain.tolist()))
        self.angle = self.speed = self.acceleration = 0.0
        self.seen = 0

    def update(self, dt_s, count):
        measured = (count + 0.5) * self.rad_per_count
        if self.seen == 0:
            self.angle = measured
        self.angle += dt_s * self.speed + 0.5 * dt_s * dt_s * self.acceleration
        self.speed += dt_s * self.acceleration
        off = measured - self.angle
        by_angle, by_speed, by_acceleration = self.gains[min(self.seen, len(self.gains) - 1)]
        self.angle += by_angle * off
        self.speed += by_speed * off
        self.acceleration += by_acceleration * off
        self.seen += 1
        return self.speed


class Estimator:
    def __init__(self, counts_per_turn, parameters, period_s):
        self.wheel, self.road = Speed(counts_per_turn, period_s), Speed(counts_per_turn, period_s)
        self.ratio = parameters.r1 / parameters.r2

    def update(self, sample, command):
        x1 = self.wheel.update(sample.dt_s, sample.wheel_count)
        x2 = self.road.update(sample.dt_s, sample.road_count)
        slip = 1.0 - self.ratio * x1 / x2 if x2 > 1.0 else 0.0
        return Estimate(x1, x2, min(max(slip, 0.0), 1.0), valid=True)
