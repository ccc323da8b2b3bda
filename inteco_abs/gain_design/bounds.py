"""Conditions of sliding over a box of rigs: F, eps_f, eps_g, and the gains required by (25) and (26).

All extremes are taken over the corners of the box, because every quantity here is monotone in each uncertain number
while the others stay: f and g are affine in S, 1/J1, 1/J2, d1, d2, M10, M20, Mg and in the brake's numbers, f/g is a
ratio of such without a pole as long as g > 0, and S itself is monotone in everything that makes it. For the radii,
which occur squared, that holds near the published geometry; tests sample it.

At one slip f = a/x2 + b and g = c/x2 (fact of equations (16) and (17)), so one corner is three numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.control import BrakingModel
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design.uncertainty import Box, SampledRig
from inteco_abs.rig import RigParameters, adhesion
from inteco_abs.rig.adhesion_curve import AdhesionCurve

Floats = NDArray[np.float64]


class Terms(NamedTuple):
    """f = a/x2 + b in 1/s and g = c/x2 in 1/(s N m) of a rig, for the torque that the law demands."""

    a: float
    b: float
    c: float


class Bounds(NamedTuple):
    """Bounds over road speed; infinite if the assumption they need does not hold."""

    F: Floats
    """Largest |f_hat|, 1/s."""
    eps_f: Floats
    """Largest |f - f_hat|, 1/s."""
    eps_g: Floats
    """Largest |1 - g/g_hat|."""
    mq_25: Floats
    """Above this (25) holds, 1/s; it needs g > 0."""
    mq_26: Floats
    """Above this (26) holds, 1/s; it needs eps_g < 1."""


def terms(drawn: SampledRig, slip: float, nominal: RigParameters) -> Terms:
    """Terms of one rig at `slip` in 0..1, 0 excluded.

    The law converts torque to duty by the line of `nominal`. The rig's own brake line then scales g and, as its offset
    acts like an external torque, adds to f. Raises ConfigError for a rig whose lever would jam.
    """
    rig, k = drawn.rig, drawn.rig.parameters
    mu = AdhesionCurve(rig.adhesion_scale, rig.adhesion_blend).adhesion(slip, k)
    if not 0.0 < mu < math.tan(k.phi_rad):
        where = f"an adhesion of {mu:.3g} at slip {slip:g} and phi = {k.phi_rad:.3g} rad"
        raise ConfigError.of("--uncertain", f"{where}: must be in 0..tan(phi); state less")
    as_here = mu / adhesion(slip, k)
    model = BrakingModel(replace(k, w1=k.w1 * as_here, w2=k.w2 * as_here, w3=k.w3 * as_here, w4=k.w4 * as_here))
    f1, g1 = model.terms(slip, 1.0)
    f2, _ = model.terms(slip, 2.0)
    a, b, c = (drawn.f_factor * 2.0 * (f1 - f2), drawn.f_factor * (2.0 * f2 - f1), drawn.g_factor * g1)
    factor = rig.brake_gain * k.b1 / nominal.b1
    offset_nm = rig.brake_gain * (k.b2 - k.b1 * rig.brake_duty_offset) - factor * nominal.b2
    return Terms(a + c * offset_nm, b, c * factor)


class AtSlip:
    """The box at one slip."""

    def __init__(self, box: Box, slip: float) -> None:
        self.slip = slip
        self.nominal = terms(box.draw({}), slip, box.nominal)
        corners = np.array([terms(corner, slip, box.nominal) for corner in box.corners()])
        self._a, self._b, self._c = corners.T[..., np.newaxis]
        self.g_positive = bool(np.all(self._c > 0.0))

    def f(self, speeds: Floats) -> Floats:
        """f_hat over road speeds > 0."""
        return self.nominal.a / speeds + self.nominal.b

    def g(self, speeds: Floats) -> Floats:
        """g_hat over road speeds > 0."""
        return self.nominal.c / speeds

    def bounds(self, speeds: Floats) -> Bounds:
        """Bounds over road speeds > 0."""
        f_hat = self.f(speeds)
        f = self._a / speeds + self._b
        ratio = self._c / self.nominal.c
        F = np.abs(f_hat)
        eps_f = np.abs(f - f_hat).max(axis=0)
        eps_g = np.full_like(speeds, np.abs(1.0 - ratio).max())
        unbounded = np.full_like(speeds, math.inf)
        # (g_hat/g)*(f - f_hat) + f_hat*(g_hat/g - 1) = (g_hat/g)*f - f_hat
        mq_25 = np.abs(f / ratio - f_hat).max(axis=0) if self.g_positive else unbounded
        mq_26 = (eps_f + eps_g * F) / (1.0 - eps_g) if eps_g[0] < 1.0 else unbounded
        return Bounds(F, eps_f, eps_g, mq_25, mq_26)

    def holding_torques(self, speeds: Floats) -> tuple[Floats, Floats]:
        """Smallest and largest torque that holds the slip, -f/g over the box, in N m."""
        if not self.g_positive:
            return np.full_like(speeds, -math.inf), np.full_like(speeds, math.inf)
        torques = -(self._a + self._b * speeds) / self._c
        return torques.min(axis=0), torques.max(axis=0)


def worst(slips: Sequence[AtSlip], speeds: Floats) -> Bounds:
    """The largest of each bound over several slips."""
    return Bounds(*np.array([one.bounds(speeds) for one in slips]).max(axis=0))
