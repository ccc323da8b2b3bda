import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.rig import accelerations

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

moving_rad_s = st.floats(0.1, 300.0) | st.floats(-300.0, -0.1)
torques_nm = st.floats(0.0, 9.03)


@pytest.mark.parametrize(("s1", "s2"), [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize(("fast_rad_s", "slow_rad_s"), [(150.0, 120.0), (20.0, 1.0), (180.0, 179.0)])
@pytest.mark.parametrize("wheel_leads", [True, False])
def test_compact_form_in_every_combination_of_signs(parameters, paper, s1, s2, fast_rad_s, slow_rad_s, wheel_leads):
    x1, x2 = (fast_rad_s, slow_rad_s) if wheel_leads else (slow_rad_s, fast_rad_s)
    x1, x2 = s1 * x1, s2 * x2
    for torque_nm in (0.0, 0.115, 4.458, 9.03):
        motion = accelerations(x1, x2, torque_nm, 0.0, parameters)
        assert motion[:2] == pytest.approx(paper.accelerations(x1, x2, torque_nm), rel=1e-12, abs=1e-9)
        assert motion.slip == pytest.approx(paper.slip(x1, x2), abs=1e-14)
        assert motion.traction == pytest.approx(paper.side(x1, x2) * paper.mu(motion.slip), rel=1e-12)
        assert motion.normal_force == pytest.approx(paper.normal_force(x1, x2, torque_nm), rel=1e-12)


@settings(deadline=None)
@given(x1=moving_rad_s, x2=moving_rad_s, torque_nm=torques_nm)
def test_compact_form_at_random_states(parameters, paper, x1, x2, torque_nm):
    motion = accelerations(x1, x2, torque_nm, 0.0, parameters)
    assert motion[:2] == pytest.approx(paper.accelerations(x1, x2, torque_nm), rel=1e-9, abs=1e-9)


def test_signs_are_those_of_each_regime(mask):
    assert accelerations(80.0, 100.0, 0.0, 0.0, mask).traction > 0.0
    assert accelerations(100.0, 80.0, 0.0, 0.0, mask).traction < 0.0
    assert accelerations(-80.0, -100.0, 0.0, 0.0, mask).traction < 0.0
    assert accelerations(-100.0, -80.0, 0.0, 0.0, mask).traction > 0.0
    assert accelerations(-1.0, 100.0, 0.0, 0.0, mask).traction > 0.0
    assert accelerations(1.0, -100.0, 0.0, 0.0, mask).traction < 0.0


def test_equal_rim_speeds_carry_no_traction(parameters):
    k = parameters
    motion = accelerations(1000.0 * k.r2, 1000.0 * k.r1, 2.0, 0.0, k)
    assert (motion.slip, motion.traction) == (0.0, 0.0)
    assert motion.wheel_acceleration == pytest.approx(-(k.d1 * 1000.0 * k.r2 + k.M10 + 2.0) / k.J1, rel=1e-13)
    assert motion.road_acceleration == pytest.approx(-(k.d2 * 1000.0 * k.r1 + k.M20) / k.J2, rel=1e-13)


def test_normal_force_at_rest_is_the_levers_weight(parameters):
    motion = accelerations(0.0, 0.0, 0.0, 0.0, parameters)
    assert motion.normal_force == pytest.approx(19.6181 / (0.370 * math.sin(math.radians(65.61))), rel=1e-12)
    assert motion.normal_force == pytest.approx(58.214, rel=1e-4)  # as measured


def test_drive_torque_acts_on_the_road_alone(parameters):
    coasting = accelerations(80.0, 100.0, 3.0, 0.0, parameters)
    driven = accelerations(80.0, 100.0, 3.0, 1.5, parameters)
    assert driven.road_acceleration - coasting.road_acceleration == pytest.approx(1.5 / 25.603e-3, rel=1e-12)
    assert driven._replace(road_acceleration=0.0) == coasting._replace(road_acceleration=0.0)


@pytest.mark.parametrize(("slip", "deceleration_rad_s2"), [(0.1, 134.0), (0.2, 136.2), (0.5, 131.0)])
def test_steady_deceleration_with_the_slip_held(mask, slip, deceleration_rad_s2):
    k, x2 = mask, 100.0
    x1 = (1.0 - slip) * k.r2 / k.r1 * x2

    def slip_rate(torque_nm):
        motion = accelerations(x1, x2, torque_nm, 0.0, k)
        return x1 / x2 * motion.road_acceleration - motion.wheel_acceleration

    holding_nm = slip_rate(0.0) / (slip_rate(0.0) - slip_rate(1.0))
    motion = accelerations(x1, x2, holding_nm, 0.0, k)
    assert motion.road_acceleration == pytest.approx(-deceleration_rad_s2, rel=0.004)


def test_steady_deceleration_of_the_locked_wheel(mask):
    assert accelerations(0.0, 130.0, 9.0, 0.0, mask).road_acceleration == pytest.approx(-133.0, rel=0.002)
