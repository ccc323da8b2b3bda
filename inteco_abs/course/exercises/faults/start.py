"""A monitor that knows one fault, and takes others for it. The page says more: docs/course/faults.md."""

from math import pi


class Monitor:
    def __init__(self, counts_per_turn, parameters, period_s):
        self.rad_per_count = 2.0 * pi / counts_per_turn
        self.still_s = 0.0
        self.before = None

    def update(self, sample, command):
        """Name of the fault, or "" as long as nothing is wrong; the first name counts."""
        if self.before is not None and sample.wheel_count == self.before:
            self.still_s += sample.dt_s
        else:
            self.still_s = 0.0
        self.before = sample.wheel_count
        # missing: what a wheel that stands still means at this speed, and the other faults
        return "wheel-stuck" if self.still_s > 0.001 else ""
