"""The reaching law of the paper, complete."""

from math import cos, sin

from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand


class Law:
    gains = (
        Gain("Mk", 2.0, 0.0, 100.0, "1/s", "rate in proportion to the slip error, (19)"),
        Gain("Mq", 1.0, 0.0, 100.0, "1/s", "constant part of the rate, (19)"),
    )
    internals = ("f", "g")

    def __init__(self, setup, Mk, Mq):
        self.reference = setup.reference_slip
        self.slowest = setup.hold_below_rad_s
        self.Mk, self.Mq = Mk, Mq
        self.k = setup.parameters  # r1, r2, J1, J2, d1, d2, M10, M20, Mg, L, phi_rad, w1..w4, a, p, b1, b2
        self.duty = 0.0

    def adhesion(self, slip):
        """mu of (8)."""
        k = self.k
        return k.w4 * slip**k.p / (k.a + slip**k.p) + k.w3 * slip**3 + k.w2 * slip**2 + k.w1 * slip

    def S(self, slip):
        """S of (9), with s = 1, in 1/m."""
        k, mu = self.k, self.adhesion(slip)
        return mu / (k.L * (sin(k.phi_rad) - mu * cos(k.phi_rad)))

    def f_and_g(self, slip, x2):
        """f in 1/s and g in 1/(N m s), (16) and (17)."""
        k, S, ratio, left = self.k, self.S(slip), self.k.r2 / self.k.r1, 1.0 - slip
        c11, c12, c13, c14 = k.r1 * k.d1 / k.J1, (k.M10 + k.Mg) * k.r1 / k.J1, -k.d1 / k.J1, -k.M10 / k.J1
        c15, c16 = k.r1 / k.J1, -1.0 / k.J1
        c21, c22, c23, c24 = -k.r2 * k.d1 / k.J2, -(k.M10 + k.Mg) * k.r2 / k.J2, -k.d2 / k.J2, -k.M20 / k.J2
        c25 = -k.r2 / k.J2
        f = -(S * c11 + c13) * left - (S * c12 + c14) / (ratio * x2)
        f += left / x2 * ((S * c21 * ratio * left + c23) * x2 + S * c22 + c24)
        g = -(c15 * S + c16 - ratio * c25 * S * left) / (ratio * x2)
        return f, g

    def update(self, estimate, dt_s):
        x2 = estimate.road_speed_rad_s
        if x2 < self.slowest:  # g grows like 1/x2: the model says nothing more
            return BrakeDemand(self.duty)
        sigma = estimate.slip - self.reference
        f, g = self.f_and_g(max(estimate.slip, 0.0), x2)
        sign = (sigma > 0.0) - (sigma < 0.0)
        torque = -(f + self.Mk * sigma + self.Mq * sign) / g
        self.duty = min(max((torque - self.k.b2) / self.k.b1, 0.0), 1.0)
        return BrakeDemand(self.duty, torque, sigma, (f, g, 0.0, 0.0))
