import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.rig import Plant, wheel_slip

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

speeds = st.just(0.0) | st.floats(1e-6, 400.0) | st.floats(-400.0, -1e-6)


@pytest.mark.parametrize(
    ("wheel_rad_s", "road_rad_s", "slip"),
    [
        (80.0, 100.0, 1 - 0.0995 * 80 / (0.099 * 100)),  # forward, braking
        (100.0, 80.0, 1 - 0.099 * 80 / (0.0995 * 100)),  # forward, driving
        (-80.0, -100.0, 1 - 0.0995 * 80 / (0.099 * 100)),  # backward, road faster
        (-100.0, -80.0, 1 - 0.099 * 80 / (0.0995 * 100)),  # backward, wheel faster
        (-5.0, 100.0, 1.0),  # opposite directions
        (5.0, -100.0, 1.0),
        (0.0, 100.0, 1.0),  # locked
        (0.0, -100.0, 1.0),
        (100.0, 0.0, 1.0),  # spinning on a standing road
        (-100.0, 0.0, 1.0),
        (0.0, 0.0, 0.0),  # both at rest, by definition
    ],
)
def test_slip_in_every_regime(wheel_rad_s, road_rad_s, slip, parameters):
    assert wheel_slip(wheel_rad_s, road_rad_s, parameters) == pytest.approx(slip, rel=1e-13)
    assert Plant(parameters, wheel_rad_s, road_rad_s).slip == wheel_slip(wheel_rad_s, road_rad_s, parameters)


def test_equal_angular_speeds_slip_by_the_difference_of_the_radii(parameters):
    assert wheel_slip(180.0, 180.0, parameters) == pytest.approx(0.0005 / 0.0995, rel=1e-12)


@pytest.mark.parametrize("scale", [1.0, -1.0, 1024.0, 0.125])
def test_equal_rim_speeds_are_rolling(scale, parameters):
    assert wheel_slip(scale * parameters.r2, scale * parameters.r1, parameters) == 0.0


@settings(deadline=None)
@given(x1=speeds, x2=speeds)
def test_slip_is_equation_7(parameters, paper, x1, x2):
    assert wheel_slip(x1, x2, parameters) == pytest.approx(paper.slip(x1, x2), abs=1e-13)


@settings(deadline=None)
@given(x1=speeds, x2=speeds)
def test_slip_stays_in_0_to_1(parameters, x1, x2):
    assert 0.0 <= wheel_slip(x1, x2, parameters) <= 1.0


@settings(deadline=None)
@given(x1=speeds, x2=speeds)
def test_turning_both_wheels_the_other_way_leaves_the_slip(parameters, x1, x2):
    assert wheel_slip(-x1, -x2, parameters) == wheel_slip(x1, x2, parameters)
