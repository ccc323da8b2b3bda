"""Road adhesion over slip, equation (8)."""

from inteco_abs import elementary
from inteco_abs.rig.parameters import RigParameters


def adhesion(slip: float, parameters: RigParameters) -> float:
    """Adhesion coefficient mu at `slip` in 0..1, equation (8).

    Slightly negative below a slip of about 1e-4, because w1 < 0. Raises ValueError for a slip outside 0..1.
    """
    require_slip(slip)
    return formula(parameters, slip)


def adhesion_slope(slip: float, parameters: RigParameters) -> float:
    """Derivative of mu by slip, for `slip` in 0..1; raises ValueError outside."""
    require_slip(slip)
    return formula_slope(parameters, slip)


def require_slip(slip: float) -> None:
    """Raise ValueError for a slip outside 0..1."""
    if not 0.0 <= slip <= 1.0:
        raise ValueError(f"slip = {slip!r}: must be in 0..1")


def formula(k: RigParameters, slip: float) -> float:
    """Return the adhesion as `adhesion` does, unchecked."""
    power = elementary.power(slip, k.p)
    return k.w4 * power / (k.a + power) + ((k.w3 * slip + k.w2) * slip + k.w1) * slip


def formula_slope(k: RigParameters, slip: float) -> float:
    """Return the slope as `adhesion_slope` does, unchecked."""
    below = k.a + elementary.power(slip, k.p)
    saturating = 0.0 if slip == 0.0 else k.w4 * k.a * k.p * elementary.power(slip, k.p - 1.0) / (below * below)
    return saturating + (3.0 * k.w3 * slip + 2.0 * k.w2) * slip + k.w1
