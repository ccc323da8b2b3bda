"""A law for brakes that are not known, to be made robust. The page says more: docs/course/robust-law.md."""

from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand


class Law:
    gains = (Gain("Kp", 1.0, 0.0, 100.0, "1", "duty per slip error"),)
    internals = ("dead time", "lag")
    estimator = "adaptive-observer"

    def __init__(self, setup, Kp):
        self.reference = setup.reference_slip
        self.k = setup.parameters  # as in the exercise reaching-law
        self.brake = setup.brake_map  # its duty(torque) is the nominal map, inverted
        self.Kp = Kp
        self.duty = 0.5

    def update(self, estimate, dt_s):
        seen = estimate.outlook  # what the observer predicts for the instant at which this demand acts
        if seen is None:
            return BrakeDemand(self.duty)
        # missing: a law on the predicted speeds, with the adhesion and the torque as estimated, and the lag inverted
        error = self.reference - estimate.slip
        self.duty = min(max(0.5 + self.Kp * error, 0.0), 1.0)
        return BrakeDemand(self.duty, 0.0, -error, (seen.brake_dead_time_s, seen.brake_lag_s, 0.0, 0.0))
