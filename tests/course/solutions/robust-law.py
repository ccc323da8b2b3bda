"""A reaching law on the predicted slip, with the adhesion as estimated, a limited approach, and the lag inverted."""

from math import copysign, cos, sin, sqrt

from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand


class Law:
    gains = (
        Gain("k", 50.0, 1.0, 1000.0, "1/s", "rate near the reference"),
        Gain("a", 25.0, 0.1, 10000.0, "1/s2", "slip deceleration far from it, at 180 rad/s"),
        Gain("kM", 300.0, 1.0, 10000.0, "1/s", "rate at which the torque closes in on the law's"),
    )
    internals = ("excess torque", "adhesion factor")
    estimator = "adaptive-observer"

    def __init__(self, setup, k, a, kM):
        self.reference = setup.reference_slip
        self.slowest = setup.hold_below_rad_s
        self.rate, self.a, self.kM = k, a, kM
        self.k = setup.parameters
        self.brake = setup.brake_map
        self.duty = 0.0

    def f_and_g(self, slip, x2, factor):
        k, left = self.k, 1.0 - slip
        grip = max(slip, 0.035)
        mu = k.w4 * grip**k.p / (k.a + grip**k.p) + k.w3 * grip**3 + k.w2 * grip**2 + k.w1 * grip
        mu *= factor
        S, ratio = mu / (k.L * (sin(k.phi_rad) - mu * cos(k.phi_rad))), k.r2 / k.r1
        c12, c22 = (k.M10 + k.Mg) * k.r1 / k.J1, -(k.M10 + k.Mg) * k.r2 / k.J2
        f = -(S * k.r1 * k.d1 / k.J1 - k.d1 / k.J1) * left - (S * c12 - k.M10 / k.J1) / (ratio * x2)
        f += left / x2 * ((-S * k.r2 * k.d1 / k.J2 * ratio * left - k.d2 / k.J2) * x2 + S * c22 - k.M20 / k.J2)
        g = -(k.r1 / k.J1 * S - 1.0 / k.J1 + ratio * k.r2 / k.J2 * S * left) / (ratio * x2)
        return f, g

    def approach(self, sigma, x2, slowest_release):
        a = min(self.a * 180.0 / x2, 400.0) / max(slowest_release, 1.0)
        if abs(sigma) * self.rate**2 <= a:
            return self.rate * sigma
        return copysign(sqrt(2.0 * a * abs(sigma) - (a / self.rate) ** 2), sigma)

    def update(self, estimate, dt_s):
        seen = estimate.outlook
        if seen is None or min(seen.road_speed_rad_s, estimate.road_speed_rad_s) < self.slowest:
            return BrakeDemand(self.duty)
        x1, x2 = seen.wheel_speed_rad_s, seen.road_speed_rad_s
        slip = min(max(1.0 - self.k.r1 * x1 / (self.k.r2 * x2), 0.0), 1.0)
        sigma = slip - self.reference
        f, g = self.f_and_g(slip, x2, seen.adhesion_factor)
        wanted = -(f + self.approach(sigma, x2, seen.slowest_release_ratio)) / g - seen.excess_torque_nm
        missing = wanted - seen.lagged_torque_nm
        lag_s = seen.brake_lag_s * (seen.brake_release_ratio if missing < 0.0 else 1.0)
        self.duty = self.brake.duty(seen.lagged_torque_nm + lag_s * self.kM * missing)
        return BrakeDemand(self.duty, wanted, sigma, (seen.excess_torque_nm, seen.adhesion_factor, 0.0, 0.0))
