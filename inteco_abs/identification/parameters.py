"""The parameters of a rig that a fit determines or assumes, and their priors.

Counts have no scale: if inertias, frictions, torques and the lever's moment are all multiplied by one number, the
counts stay the same. So the search is for ratios to the moment of inertia of both wheels as they roll,
J = J2 + (r2/r1)^2*J1, at its prior; `scale`, the ratio of the true J to that, cannot be identified. Run-up and
coast-down then determine only the sums over both wheels: d = d2 + (r2/r1)^2*d1, and M0 = M20 + (r2/r1)*M10.

The form of the friction curve is assumed, too: equation (8). The manual's measured surface (figure 5.6c) has another,
which no choice of its constants gives exactly, and what is left moves the slip at small torques and with it the ratio
of the radii. `blend`, the share of the measured curve in the rig's, stays 0 in the search; that it may be 1 is part of
the intervals.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.rig import LONGEST_DEAD_TIME_S, DriveMotor, RigParameters, RigVariation, measured_torque

Floats = npt.NDArray[np.float64]

ASSUMED: Final[Mapping[str, float]] = {"J1": 0.05, "J2": 0.05, "Mg": 0.05, "d1": 0.2, "M10": 0.6}
"""Assumed parameters, and their uncertainty in both directions as a share. M10: the manual's table 3 has 0.0022 to
0.0050 N m for one rig; the others as in the population `hard`."""
_SCALED: Final = ("J1", "Mg", "d1", "M10")
FIXED: Final = ("scale", *_SCALED, "blend")
"""Parameters that stay at their priors in the search, the first ones."""
FULL_NM: Final = 20.0
"""More than any brake of this rig gives; the plant gets torques as shares of it."""
_UNIFORM: Final = math.sqrt(3.0)
"""Half the width of a uniform distribution over its standard deviation."""


class FitParameter(NamedTuple):
    """One parameter of the search. With `log`, its coordinate is the logarithm of its ratio to the prior."""

    name: str
    prior: float
    sd: float
    """Standard deviation of the prior of the coordinate."""
    log: bool = True

    @property
    def start(self) -> float:
        """Coordinate at which the search begins."""
        return 0.0 if self.log else self.prior

    def value(self, coordinate: float) -> float:
        """Value of the parameter."""
        return self.prior * math.exp(coordinate) if self.log else coordinate


def torque_name(duty: float) -> str:
    """Name of the torque that the brake settles to at `duty`."""
    return f"M1({duty:.4g})"


@dataclass(frozen=True)
class Priors:
    """All parameters of the search around the rig `base`, with its brake driven at the duties `levels`."""

    base: RigParameters
    levels: tuple[float, ...]
    assumed: Mapping[str, float]

    @cached_property
    def fit_parameters(self) -> tuple[FitParameter, ...]:
        """The parameters of ASSUMED (with `scale` instead of J2), then those to be found."""
        k, motor, share = self.base, DriveMotor(), self.rolling_share
        lag = 1.0 / k.c31 if math.isfinite(k.c31) else 0.05
        return (
            FitParameter("scale", 1.0, 1.0),
            FitParameter("J1", k.J1, 1.0),
            FitParameter("Mg", k.Mg, 1.0),
            FitParameter("d1", k.d1, 1.0),
            FitParameter("M10", k.M10, 1.0),
            FitParameter("blend", 0.0, 1.0 / _UNIFORM, log=False),
            FitParameter("r1/r2", k.r1 / k.r2, _RADII),
            FitParameter("d", k.d2 + share * k.d1, 1.0),
            FitParameter("M0", k.M20 + k.r2 / k.r1 * k.M10, 1.0),
            FitParameter("stall", motor.stall_torque_nm, 1.0),
            FitParameter("no_load", motor.no_load_speed_rad_s, 1.0),
            FitParameter("creep", k.a, 0.5),
            FitParameter("creep_p", k.p, 0.1),
            FitParameter("w4", k.w4, 0.3),
            FitParameter("w1/w4", k.w1 / k.w4, 0.5, log=False),
            FitParameter("w2/w4", k.w2 / k.w4, 0.5, log=False),
            FitParameter("w3/w4", k.w3 / k.w4, 0.5, log=False),
            FitParameter("a", k.a, 1.0),
            FitParameter("p", k.p, 0.1),
            FitParameter("lag", lag, 0.05, log=False),
            FitParameter("dead_time", 0.01, 0.02, log=False),
            FitParameter("release", 1.0, 0.5),
            FitParameter("release_delay", 0.0, 0.02, log=False),
            FitParameter("fade", 0.0, 0.2, log=False),
            *(FitParameter(torque_name(duty), measured_torque(duty), 3.0, log=False) for duty in self.levels),
        )

    @cached_property
    def weights(self) -> Floats:
        """The priors as rows of equations, each over its standard deviation.

        What is assumed has absolute priors, which fix the scale; all others have priors of their ratio to J.
        """
        names = [each.name for each in self.fit_parameters]
        scale, J1, Mg, d1, M10, _ = (names.index(name) for name in FIXED)
        rows = np.diag([1.0 / each.sd for each in self.fit_parameters])
        rows[[scale, J1, Mg, d1, M10]] = 0.0
        k = self.base
        for row, name, place, slope in (
            (scale, "J2", J1, -self.rolling_share * k.J1 / k.J2),  # J stays as it is when J1 grows
            (J1, "J1", J1, 1.0),
            (Mg, "Mg", Mg, 1.0),
            (d1, "d1", d1, 1.0),
            (M10, "M10", M10, 1.0),
        ):
            sd = self.assumed[name] / _UNIFORM
            rows[row, scale], rows[row, place] = 1.0 / sd, slope / sd
        return rows

    @property
    def rolling_share(self) -> float:
        """Weight of the wheel's inertia and viscous friction in those of both wheels as they roll, at the prior."""
        return (self.base.r2 / self.base.r1) ** 2

    def values(self, coordinates: Iterable[float]) -> dict[str, float]:
        """Parameters by name, from the coordinates of the search.

        Other radii change the J of wheels whose J1 and J2 are those of the priors. The search keeps J all the same, as
        all that it finds would have to follow the radii; so the scale has that change, and those of FIXED whose priors
        are absolute have its inverse.
        """
        found = {each.name: each.value(one) for each, one in zip(self.fit_parameters, coordinates, strict=False)}
        k, ratio = self.base, found["r1/r2"]
        change = (k.J2 + k.J1 / (ratio * ratio)) / (k.J2 + self.rolling_share * k.J1)
        found["scale"] *= change
        for name in _SCALED:
            found[name] /= change
        return found

    def parameters(self, values: Mapping[str, float], *, scaled: bool = True) -> RigParameters:
        """The rig's constants, with the prior's scale unless `scaled`; the brake map is that of `base`."""
        k, scale, ratio = self.base, values["scale"] if scaled else 1.0, values["r1/r2"]
        share = 1.0 / (ratio * ratio)
        J1, d1, M10, w4 = values["J1"], values["d1"], values["M10"], values["w4"]
        return replace(
            k,
            r1=ratio * k.r2,
            J1=scale * J1,
            J2=scale * max(k.J2 + self.rolling_share * k.J1 - share * J1, _LEAST * k.J2),
            d1=scale * d1,
            d2=scale * max(values["d"] - share * d1, _LEAST * k.d2),
            M10=scale * M10,
            M20=scale * max(values["M0"] - M10 / ratio, _LEAST * k.M20),
            Mg=scale * values["Mg"],
            w1=values["w1/w4"] * w4,
            w2=values["w2/w4"] * w4,
            w3=values["w3/w4"] * w4,
            w4=w4,
            a=values["a"],
            p=values["p"],
            c31=1.0 / max(values["lag"], _SHORTEST_LAG_S),
        )

    def variation(self, values: Mapping[str, float], *, rolling: bool) -> RigVariation:
        """The simulated rig, with the prior's scale; its duty is a torque as a share of FULL_NM.

        With `rolling` its contact is that of wheels that roll: their creep, slip of less than 0.01, must not bend the
        friction curve of braking, nor that curve the ratio of the radii, which follows from creep.
        """
        k = replace(self.parameters(values, scaled=False), b1=FULL_NM, b2=0.0, u0=0.0)
        if rolling:
            base = self.base
            k = replace(k, w1=base.w1, w2=base.w2, w3=base.w3, w4=base.w4, a=values["creep"], p=values["creep_p"])
        dead_time_s, released_s = (
            min(_CORNER_S * float(np.logaddexp(0.0, each / _CORNER_S)), LONGEST_DEAD_TIME_S)
            for each in (values["dead_time"], values["dead_time"] + values["release_delay"])
        )
        return RigVariation(
            k,
            brake_dead_time_s=dead_time_s,
            brake_release_ratio=min(max(values["release"], 0.1), 10.0),
            brake_release_delay_s=released_s - dead_time_s,
        )


_RADII: Final = 0.03
"""Standard deviation of the radii's ratio; the vendor's toolbox has a wheel 4 % smaller."""
_LEAST: Final = 0.01
"""Least share of its prior for a parameter that is the difference of others."""
_CORNER_S: Final = 3e-4
"""Width of the rounded corner where a rise or a release acts at once: beyond a sharp one nothing would change, and no
search by slopes gets away from it. A dead time by its logarithm has no corner, but a valley without end instead."""
_SHORTEST_LAG_S: Final = 1e-4
"""Practically none, as of a brake without lag."""
