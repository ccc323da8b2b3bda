import numpy as np
import pytest

from inteco_abs.rig import adhesion, adhesion_slope, measured_adhesion, measured_adhesion_slope
from inteco_abs.rig.adhesion_curve import MEASURED_ADHESION, AdhesionCurve, blended_slope

POINTS = [(0.1, 0.384), (0.2, 0.393), (0.4, 0.402), (0.6, 0.410), (0.8, 0.414), (1.0, 0.409)]


def test_curve_passes_through_nothing_and_every_measured_point():
    assert list(MEASURED_ADHESION) == POINTS
    assert measured_adhesion(0.0) == 0.0
    assert [measured_adhesion(slip) for slip, _ in POINTS] == pytest.approx([mu for _, mu in POINTS], rel=1e-14)


def test_curve_rises_to_0_8_and_falls_after_it_without_bumps():
    rising = [measured_adhesion(slip) for slip in np.linspace(0.001, 0.8, 3000)]
    falling = [measured_adhesion(slip) for slip in np.linspace(0.8, 1.0, 1000)]
    assert np.all(np.diff(rising) > 0.0)
    assert np.all(np.diff(falling) < 0.0)


@pytest.mark.parametrize("slip", [1e-5, 0.003, 0.02, 0.0999])
def test_below_the_first_point_it_rises_as_the_formula_does(mask, slip):
    assert measured_adhesion(slip) / adhesion(slip, mask) == pytest.approx(0.384 / adhesion(0.1, mask), rel=1e-13)


@pytest.mark.parametrize("slip", [0.003, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.95])
def test_slope_is_the_derivative_on_both_sides_also_at_the_points(slip):
    step = slip * 1e-5
    for side in (-step, step):
        difference = (measured_adhesion(slip + side) - measured_adhesion(slip)) / side
        assert measured_adhesion_slope(slip) == pytest.approx(difference, rel=1e-3, abs=2e-5)


@pytest.mark.parametrize("slip", [-1e-9, 1.0 + 1e-9, float("nan")])
@pytest.mark.parametrize("curve", [measured_adhesion, measured_adhesion_slope])
def test_a_slip_outside_0_to_1_is_refused(curve, slip):
    with pytest.raises(ValueError, match=r"must be in 0\.\.1"):
        curve(slip)


@pytest.mark.parametrize("slip", [0.0, 0.01, 0.2, 0.9, 1.0])
def test_a_surface_is_a_scaled_blend_of_formula_and_measured_curve(mask, slip):
    surface = AdhesionCurve(1.1, 0.25)
    blend = 0.75 * adhesion(slip, mask) + 0.25 * measured_adhesion(slip)
    slope = 0.75 * adhesion_slope(slip, mask) + 0.25 * measured_adhesion_slope(slip)
    assert surface.adhesion(slip, mask) == pytest.approx(1.1 * blend, rel=1e-14)
    assert blended_slope(mask, 0.25, slip) == pytest.approx(slope, rel=1e-14)
