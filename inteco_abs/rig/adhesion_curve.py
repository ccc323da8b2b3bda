"""Adhesion of a rig's own road: the measured curve, and its blend with equation (8)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from inteco_abs import elementary
from inteco_abs.rig.friction import adhesion, adhesion_slope, formula, formula_slope, require_slip
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.state import Constants, State


class Cubic(NamedTuple):
    """One piece of a curve, in powers of the distance from its start."""

    start: float
    value: float
    slope: float
    square: float
    cube: float


MEASURED_ADHESION: Final = ((0.1, 0.384), (0.2, 0.393), (0.4, 0.402), (0.6, 0.410), (0.8, 0.414), (1.0, 0.409))
"""Slip and adhesion read off the surface measured in the manual, figure 5.6c: no peak near 0.2, unlike (8)."""


def monotone_cubics(points: Sequence[tuple[float, float]], first_slope: float) -> tuple[Cubic, ...]:
    """Monotone curve through `points` with a continuous slope, `first_slope` at its start.

    Slopes by the harmonic mean of the neighbouring chords (Fritsch and Butland 1984), 0 where the points turn.
    """
    chords = [(y1 - y0) / (x1 - x0) for (x0, y0), (x1, y1) in pairwise(points)]
    inner = [2.0 * a * b / (a + b) if a * b > 0.0 else 0.0 for a, b in pairwise(chords)]
    slopes = [first_slope, *inner, chords[-1]]
    cubics = []
    for i, chord in enumerate(chords):
        width = points[i + 1][0] - points[i][0]
        square = (3.0 * chord - 2.0 * slopes[i] - slopes[i + 1]) / width
        cube = (slopes[i] + slopes[i + 1] - 2.0 * chord) / elementary.raised(width, 2)
        cubics.append(Cubic(*points[i], slopes[i], square, cube))
    return tuple(cubics)


_TILT_AT: Final = 0.2
"""Slip at which a tilt changes nothing."""
_PUBLISHED: Final = RigParameters.named("mask")
RISE_END: Final = MEASURED_ADHESION[0][0]
"""Slip of the first measured point; below it the curve rises as equation (8) does."""
RISE: Final = MEASURED_ADHESION[0][1] / adhesion(RISE_END, _PUBLISHED)
"""Measured adhesion over that of (8) where the rise ends."""
MEASURED_CUBICS: Final = monotone_cubics(MEASURED_ADHESION, RISE * adhesion_slope(RISE_END, _PUBLISHED))


def measured_adhesion(slip: float) -> float:
    """Measured adhesion at `slip`, continuously differentiable. Raises ValueError outside 0..1."""
    require_slip(slip)
    return _measured(slip)


def measured_adhesion_slope(slip: float) -> float:
    """Derivative of `measured_adhesion` by slip; raises ValueError outside 0..1."""
    require_slip(slip)
    return _measured_slope(slip)


def blended(k: RigParameters, blend: float, slip: float) -> float:
    """Adhesion at `slip` in 0..1: equation (8), with a share of `blend` in 0..1 of the measured curve."""
    if blend == 0.0:
        return formula(k, slip)
    return (1.0 - blend) * formula(k, slip) + blend * _measured(slip)


def blended_slope(k: RigParameters, blend: float, slip: float) -> float:
    """Derivative of `blended` by slip."""
    return (1.0 - blend) * formula_slope(k, slip) + blend * _measured_slope(slip)


def road_adhesion(k: Constants, s: State, slip: float) -> float:
    """Adhesion of the rig's own curve or of its road at `slip` in 0..1, tilted, before the factor `grip`."""
    if s.road_c1 > 0.0:
        mu = s.road_c1 * (1.0 - elementary.exp(-s.road_c2 * slip)) - s.road_c3 * slip
    else:
        mu = blended(k, k.adhesion_blend, slip)
    return mu * (1.0 + k.adhesion_tilt * (slip - _TILT_AT)) if k.adhesion_tilt != 0.0 else mu


def road_adhesion_slope(k: Constants, s: State, slip: float) -> float:
    """Derivative of `road_adhesion` by slip."""
    if s.road_c1 > 0.0:
        slope = s.road_c1 * s.road_c2 * elementary.exp(-s.road_c2 * slip) - s.road_c3
    else:
        slope = blended_slope(k, k.adhesion_blend, slip)
    if k.adhesion_tilt == 0.0:
        return slope
    tilt, untilted = 1.0 + k.adhesion_tilt * (slip - _TILT_AT), road_adhesion(k, s, slip)
    return slope * tilt + untilted / tilt * k.adhesion_tilt


def _measured(slip: float) -> float:
    if slip < RISE_END:
        return RISE * formula(_PUBLISHED, slip)
    start, value, slope, square, cube = _measured_piece(slip)
    t = slip - start
    return ((cube * t + square) * t + slope) * t + value


def _measured_slope(slip: float) -> float:
    if slip < RISE_END:
        return RISE * formula_slope(_PUBLISHED, slip)
    start, _, slope, square, cube = _measured_piece(slip)
    t = slip - start
    return (3.0 * cube * t + 2.0 * square) * t + slope


def _measured_piece(slip: float) -> Cubic:
    found = MEASURED_CUBICS[0]
    for piece in MEASURED_CUBICS:
        if slip < piece.start:
            break
        found = piece
    return found


class AdhesionCurve:
    """The contact of one rig: a scaled blend of equation (8) and the measured curve."""

    __slots__ = ("_blend", "_scale")

    def __init__(self, scale: float, blend: float) -> None:
        self._scale = scale
        self._blend = blend

    def adhesion(self, slip: float, parameters: RigParameters) -> float:
        """Adhesion at `slip`; raises ValueError outside 0..1."""
        require_slip(slip)
        return self._scale * blended(parameters, self._blend, slip)
