import math

import pytest

from inteco_abs.rig import RigParameters


class Paper:
    """The paper's equations (5), (7), (8), (9) and (10) as printed, sharing no code with the product."""

    def __init__(self, k):
        self.k = k

    def mu(self, slip):
        k = self.k
        return k.w4 * slip**k.p / (k.a + slip**k.p) + k.w3 * slip**3 + k.w2 * slip**2 + k.w1 * slip

    def slip(self, x1, x2):
        v1, v2 = self.k.r1 * x1, self.k.r2 * x2
        if (x1 >= 0) != (x2 >= 0):
            return 1.0
        if x1 == x2 == 0:
            return 0.0
        forward = x1 >= 0
        road_leads = v2 >= v1 if forward else v2 < v1
        return (v2 - v1) / v2 if road_leads else (v1 - v2) / v1

    def side(self, x1, x2):
        return sgn(self.k.r2 * x2 - self.k.r1 * x1)

    def lever(self, x1, x2):
        k, pull = self.k, self.side(x1, x2) * self.mu(self.slip(x1, x2))
        return k.L * (math.sin(k.phi_rad) - pull * math.cos(k.phi_rad))

    def S(self, x1, x2):
        return self.side(x1, x2) * self.mu(self.slip(x1, x2)) / self.lever(x1, x2)

    def normal_force(self, x1, x2, M1):
        k, s1 = self.k, sgn(x1)
        return (k.Mg + s1 * M1 + s1 * k.M10 + k.d1 * x1) / self.lever(x1, x2)

    def coefficients(self, s1, s2):
        k = self.k
        c1 = (
            k.r1 * k.d1 / k.J1,
            (s1 * k.M10 + k.Mg) * k.r1 / k.J1,
            -k.d1 / k.J1,
            -s1 * k.M10 / k.J1,
            k.r1 / k.J1,
            -1 / k.J1,
        )
        c2 = (
            -k.r2 * k.d1 / k.J2,
            -(s1 * k.M10 + k.Mg) * k.r2 / k.J2,
            -k.d2 / k.J2,
            -s2 * k.M20 / k.J2,
            -k.r2 / k.J2,
        )
        return c1, c2

    def accelerations(self, x1, x2, M1):
        S, s1, s2 = self.S(x1, x2), sgn(x1), sgn(x2)
        (c11, c12, c13, c14, c15, c16), (c21, c22, c23, c24, c25) = self.coefficients(s1, s2)
        return (
            S * (c11 * x1 + c12) + c13 * x1 + c14 + (c15 * S + c16) * s1 * M1,
            S * (c21 * x1 + c22) + c23 * x2 + c24 + c25 * S * s1 * M1,
        )

    def dissipation_w(self, x1, x2, M1):
        """Power that leaves both moving wheels, W."""
        k = self.k
        rubbing = self.normal_force(x1, x2, M1) * self.mu(self.slip(x1, x2)) * abs(k.r2 * x2 - k.r1 * x1)
        return rubbing + k.d1 * x1**2 + abs(x1) * (k.M10 + M1) + k.d2 * x2**2 + abs(x2) * k.M20

    def locked_normal_force(self):
        """Force on a locked wheel, N, road turning forward: the brake carries the torque that the road puts in."""
        k, mu = self.k, self.mu(1.0)
        return k.Mg / (k.L * (math.sin(k.phi_rad) - mu * math.cos(k.phi_rad)) - k.r1 * mu)


def sgn(value):
    return int(value > 0) - int(value < 0)


@pytest.fixture(scope="session", params=["mask", "table"])
def parameters(request):
    return RigParameters.named(request.param)


@pytest.fixture(scope="session")
def mask():
    return RigParameters.named("mask")


@pytest.fixture(scope="session")
def paper(parameters):
    return Paper(parameters)


@pytest.fixture(scope="session")
def paper_of():
    return Paper
