"""An estimator: differences over one period, much too noisy. The page says more: docs/course/estimator.md."""

from math import pi

from inteco_abs.signals import Estimate


class Speed:
    """Speed of one wheel from its counts."""

    def __init__(self, counts_per_turn, period_s):
        self.rad_per_count = 2.0 * pi / counts_per_turn
        self.before = None

    def update(self, dt_s, count):
        """Speed in rad/s."""
        # missing: a filter
        speed = 0.0 if self.before is None else (count - self.before) * self.rad_per_count / dt_s
        self.before = count
        return speed


class Estimator:
    def __init__(self, counts_per_turn, parameters, period_s):
        self.wheel, self.road = Speed(counts_per_turn, period_s), Speed(counts_per_turn, period_s)
        self.ratio = parameters.r1 / parameters.r2

    def update(self, sample, command):
        """Estimate of now, from sample.wheel_count, sample.road_count and sample.dt_s."""
        x1 = self.wheel.update(sample.dt_s, sample.wheel_count)
        x2 = self.road.update(sample.dt_s, sample.road_count)
        slip = 1.0 - self.ratio * x1 / x2 if x2 > 1.0 else 0.0
        return Estimate(x1, x2, min(max(slip, 0.0), 1.0), valid=True)
