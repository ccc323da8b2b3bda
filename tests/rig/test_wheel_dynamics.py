import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.rig import accelerations

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

moving_rad_s = st.floats(0.1, 300.0) | st.floats(-300.0, -0.1)
torques_nm = st.floats(0.0, 9.03)


def braking_states(count):
    random = np.random.default_rng(20110606)
    return zip(
        random.uniform(0.01, 0.95, count),
        random.uniform(2.0, 185.0, count),
        random.uniform(0.0, 9.0, count),
        strict=True,
    )


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


def test_braking_raises_the_normal_force(parameters):
    forces_n = [accelerations(80.0, 100.0, torque_nm, 0.0, parameters).normal_force for torque_nm in (0.0, 3.0, 9.0)]
    assert forces_n == sorted(set(forces_n))


def test_drive_torque_acts_on_the_road_alone(parameters):
    coasting = accelerations(80.0, 100.0, 3.0, 0.0, parameters)
    driven = accelerations(80.0, 100.0, 3.0, 1.5, parameters)
    assert driven.road_acceleration - coasting.road_acceleration == pytest.approx(1.5 / 25.603e-3, rel=1e-12)
    assert driven._replace(road_acceleration=0.0) == coasting._replace(road_acceleration=0.0)


def test_coefficients_found_in_the_accelerations_have_the_printed_structure(parameters, paper):
    k = parameters
    rows1, rows2, answers = [], [], []
    for slip, x2, torque_nm in braking_states(400):
        x1 = (1.0 - slip) * k.r2 / k.r1 * x2
        S = paper.S(x1, x2)
        rows1.append((S * x1, S, x1, 1.0, S * torque_nm, torque_nm))
        rows2.append((S * x1, S, x2, 1.0, S * torque_nm))
        answers.append(accelerations(x1, x2, torque_nm, 0.0, k)[:2])
    answers = np.array(answers)
    c1 = np.linalg.lstsq(np.array(rows1), answers[:, 0])[0]
    c2 = np.linalg.lstsq(np.array(rows2), answers[:, 1])[0]
    printed1, printed2 = paper.coefficients(1, 1)
    assert c1 == pytest.approx(printed1, rel=1e-7)
    assert c2 == pytest.approx(printed2, rel=1e-7)
    c11, c12, c13, c14, c15, c16 = c1
    c21, c22, _c23, _c24, c25 = c2
    assert c11 == pytest.approx(-k.r1 * c13, rel=1e-7)
    assert c12 / c15 == pytest.approx(k.Mg + k.M10, rel=1e-7)
    assert c14 == pytest.approx(k.M10 * c16, rel=1e-7)
    ratio = -k.r2 * k.J1 / (k.r1 * k.J2)
    assert (c21 / c11, c22 / c12, c25 / c15) == pytest.approx((ratio, ratio, ratio), rel=1e-7)
    assert min(c11, c12, c15) > 0.0 > max(c13, c14, c16, *c2)


@settings(deadline=None)
@given(x1=moving_rad_s, x2=moving_rad_s)
def test_contact_pushes_both_wheels_with_the_normal_force_it_reports(parameters, x1, x2):
    k = parameters
    motion = accelerations(x1, x2, 0.0, 0.0, k)
    push = motion.normal_force * motion.traction
    s1, s2 = math.copysign(1.0, x1), math.copysign(1.0, x2)
    assert motion.wheel_acceleration * k.J1 == pytest.approx(push * k.r1 - k.d1 * x1 - s1 * k.M10, abs=1e-10)
    assert motion.road_acceleration * k.J2 == pytest.approx(-push * k.r2 - k.d2 * x2 - s2 * k.M20, abs=1e-10)


@pytest.mark.parametrize("slip", [0.05, 0.2, 0.5, 0.9])
def test_more_brake_torque_always_raises_the_slip(parameters, slip):
    k, x2 = parameters, 90.0
    x1 = (1.0 - slip) * k.r2 / k.r1 * x2
    slip_rates = []
    for torque_nm in (0.0, 3.0, 6.0, 9.0):
        motion = accelerations(x1, x2, torque_nm, 0.0, k)
        slip_rates.append(k.r1 / (k.r2 * x2) * (x1 / x2 * motion.road_acceleration - motion.wheel_acceleration))
    assert slip_rates == sorted(set(slip_rates))


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
