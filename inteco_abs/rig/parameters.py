"""The two published parameter sets of the rig."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True, slots=True)
class RigParameters:
    """Constants of the model, in SI units, named after the paper's symbols.

    Source: Inteco ABS user's manual, tables 2 to 4 and figure 6.3. The paper itself prints no parameters.
    """

    r1: float
    """Radius of the upper wheel, the braked one, m."""
    r2: float
    """Radius of the lower wheel, the road, m."""
    phi_rad: float
    """Angle between the contact normal and the lever, rad."""
    L: float
    """Distance from the contact to the lever's axis, m."""
    J1: float
    """Moment of inertia of the upper wheel, kg m2."""
    J2: float
    """Moment of inertia of the lower wheel, kg m2."""
    d1: float
    """Viscous friction of the upper wheel, N m s."""
    d2: float
    """Viscous friction of the lower wheel, N m s."""
    M10: float
    """Static friction of the upper wheel, N m."""
    M20: float
    """Static friction of the lower wheel, N m."""
    Mg: float
    """Gravity and shock absorber torque on the lever, N m."""
    w1: float
    """Friction curve, linear term. Negative: the printed coefficients are only met so."""
    w2: float
    """Friction curve, quadratic term."""
    w3: float
    """Friction curve, cubic term."""
    w4: float
    """Friction curve, height of the saturating term."""
    a: float
    """Friction curve, position of the saturating term."""
    p: float
    """Friction curve, exponent of the saturating term."""
    c31: float
    """Rate of the brake actuator's lag, 1/s; infinite for a brake that follows at once."""
    b1: float
    """Brake static map, slope, N m per unit duty."""
    b2: float
    """Brake static map, offset, N m."""
    u0: float
    """Duty below which the brake gives no torque."""

    @staticmethod
    def named(name: str) -> RigParameters:
        """The set `mask` (the manual's simulator, behind all its printed figures) or `table` (identification).

        Raises ValueError for any other name.
        """
        try:
            return _SETS[name]
        except KeyError:
            raise ValueError(f"parameter set {name!r}: must be one of {', '.join(_SETS)}") from None


_MASK: Final = RigParameters(
    r1=0.0995,
    r2=0.099,
    phi_rad=math.radians(65.61),
    L=0.370,
    J1=7.5281e-3,
    J2=25.603e-3,
    d1=1.2e-4,
    d2=2.25e-4,
    M10=0.003,
    M20=0.093,
    Mg=19.6181,
    w1=-0.04240011450454,
    w2=2.9375e-10,
    w3=0.03508217905067,
    w4=0.40662691102315,
    a=0.00025724985785,
    p=2.09945271667129,
    c31=20.37,  # manual pages 31 and 36; the mask's own 1/0.048 is for comparison with the vendor's simulator
    b1=15.24,
    b2=-6.21,
    u0=0.415,
)
_SETS: Final = {"mask": _MASK, "table": replace(_MASK, d1=1.1874e-4, d2=2.1468e-4, M10=0.0032, M20=0.0925)}
