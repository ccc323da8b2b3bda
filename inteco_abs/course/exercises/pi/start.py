"""A PI controller: what is missing is marked. The page says what it must keep: docs/course/pi.md."""

from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand


class Law:
    gains = (
        Gain("bias", 0.5, 0.0, 1.0, "1", "duty at which the integral begins"),
        Gain("Kp", 0.1, 0.0, 100.0, "1", "duty per slip error"),
        Gain("Ki", 0.1, 0.0, 100.0, "1/s", "duty per slip error and second"),
    )
    internals = ("integral",)

    def __init__(self, setup, bias, Kp, Ki):
        self.reference = setup.reference_slip
        self.Kp, self.Ki = Kp, Ki
        self.integral = bias

    def update(self, estimate, dt_s):
        error = self.reference - estimate.slip
        # missing: the integral, and its limits
        duty = self.integral + self.Kp * error
        return BrakeDemand(min(max(duty, 0.0), 1.0), switching=-error, internals=(self.integral, 0.0, 0.0, 0.0))
