"""PI with a bias, an integral that waits while the brake is at its limit, and gains in proportion to the speed."""

from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand


class Law:
    gains = (
        Gain("bias", 0.62, 0.0, 1.0, "1", "duty at which the integral begins"),
        Gain("Kp", 2.0, 0.0, 100.0, "1", "duty per slip error at 180 rad/s"),
        Gain("Ki", 6.0, 0.0, 100.0, "1/s", "duty per slip error and second at 180 rad/s"),
    )
    internals = ("integral",)

    def __init__(self, setup, bias, Kp, Ki):
        self.reference = setup.reference_slip
        self.Kp, self.Ki = Kp, Ki
        self.integral = bias

    def update(self, estimate, dt_s):
        error = self.reference - estimate.slip
        share = max(estimate.road_speed_rad_s, 10.0) / 180.0
        duty = self.integral + self.Kp * share * error
        if 0.0 < duty < 1.0:
            self.integral += self.Ki * share * error * dt_s
        return BrakeDemand(min(max(duty, 0.0), 1.0), switching=-error, internals=(self.integral, 0.0, 0.0, 0.0))
