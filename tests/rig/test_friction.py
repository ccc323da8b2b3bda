import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from inteco_abs.rig import adhesion, adhesion_slope

PEAK_SLIP = 0.18747


@settings(deadline=None)
@given(slip=st.floats(0.0, 1.0))
def test_curve_is_equation_8(parameters, paper, slip):
    assert adhesion(slip, parameters) == pytest.approx(paper.mu(slip), rel=1e-13, abs=1e-18)


def test_no_slip_gives_no_adhesion(parameters):
    assert adhesion(0.0, parameters) == 0.0


def test_locked_wheel_value_from_the_published_constants(parameters):
    assert adhesion(1.0, parameters) == pytest.approx(
        0.4066269110 / 1.00025724986 + 0.03508217905 - 0.04240011421, rel=1e-9
    )


def test_local_maximum_lies_where_published(parameters):
    peak = minimize_scalar(lambda slip: -adhesion(slip, parameters), bounds=(0.1, 0.3), options={"xatol": 1e-7})
    assert peak.x == pytest.approx(PEAK_SLIP, abs=1e-5)


def test_curve_falls_right_after_its_peak_to_a_shallow_minimum_and_rises_again(parameters):
    slips = np.linspace(0.188, 1.0, 500)
    values = np.array([adhesion(slip, parameters) for slip in slips])
    lowest = int(values.argmin())
    assert 0 < lowest < len(slips) - 1
    assert np.all(np.diff(values[: lowest + 1]) < 0.0)
    assert np.all(np.diff(values[lowest:]) > 0.0)


def test_global_maximum_is_the_locked_wheel(parameters):
    values = [adhesion(step / 2000, parameters) for step in range(2001)]
    assert max(range(2001), key=values.__getitem__) == 2000


def test_adhesion_is_slightly_negative_at_tiny_slip_and_positive_beyond(parameters):
    assert -1e-5 < adhesion(2e-5, parameters) < 0.0
    assert all(adhesion(slip, parameters) > 0.0 for slip in np.geomspace(3e-4, 1.0, 200))


def test_the_sign_of_w1_makes_the_peak(parameters):
    flipped = replace(parameters, w1=-parameters.w1)
    slips = np.linspace(0.1, 1.0, 200)
    assert np.all(np.diff([adhesion(slip, flipped) for slip in slips]) > 0.0)


@pytest.mark.parametrize("slip", [1e-4, 0.003, 0.02, 0.1, PEAK_SLIP, 0.5, 0.999])
def test_slope_is_the_derivative_of_the_curve(parameters, paper, slip):
    step = slip * 1e-4
    difference = (paper.mu(slip + step) - paper.mu(slip - step)) / (2 * step)
    assert adhesion_slope(slip, parameters) == pytest.approx(difference, rel=1e-6, abs=1e-7)


def test_slope_at_no_slip_is_w1(parameters):
    assert adhesion_slope(0.0, parameters) == parameters.w1


def test_slope_vanishes_at_the_peak(parameters):
    assert adhesion_slope(PEAK_SLIP, parameters) == pytest.approx(0.0, abs=1e-5)
    assert adhesion_slope(PEAK_SLIP - 0.001, parameters) > 0.0 > adhesion_slope(PEAK_SLIP + 0.001, parameters)


@pytest.mark.parametrize("slip", [-1e-12, 1.0000001, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("curve", [adhesion, adhesion_slope])
def test_slip_outside_0_to_1_is_refused(curve, slip, mask):
    with pytest.raises(ValueError, match=r"slip = .*0\.\.1"):
        curve(slip, mask)
