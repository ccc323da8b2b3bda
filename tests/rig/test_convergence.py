from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from inteco_abs.rig import Plant, brake_torque

pytestmark = pytest.mark.untraced

ROLLING = 0.099 / 0.0995


def state_after(parameters, start, brake, duration_s, max_step_s):
    plant = Plant(parameters, *start, max_step_s=max_step_s)
    for _ in range(round(duration_s / 0.004)):
        plant.advance(0.0, brake, 0.004)
    return np.array([plant.wheel_speed, plant.road_speed, plant.wheel_angle, plant.road_angle])


def reference(paper, start, brake, duration_s):
    """Speeds, angles and torque by an independent integrator over the printed equations."""
    k = paper.k
    settled_nm = brake_torque(brake, k)

    def derivative(_time_s, state):
        x1, x2, torque_nm = state[:3]
        return (*paper.accelerations(x1, x2, torque_nm), k.c31 * (settled_nm - torque_nm), x1, x2)

    found = solve_ivp(derivative, (0.0, duration_s), (*start, 0.0, 0.0, 0.0), method="LSODA", rtol=1e-10, atol=1e-11)
    assert found.success
    return found.y[:, -1]


@pytest.mark.parametrize(
    ("start", "brake", "duration_s"),
    [
        ((180.0 * ROLLING, 180.0), 1.0, 0.1),  # rising slip
        ((180.0 * ROLLING, 180.0), 1.0, 0.3),  # close to lock
        ((150.0, 30.0), 0.6, 0.2),  # wheel faster than the road
        ((-100.0, 100.0), 0.6, 0.1),  # opposite directions
        ((30.0, 30.0), 0.6, 0.2),  # stiff contact at low speed
    ],
)
def test_halving_the_step_divides_the_error_by_four(parameters, start, brake, duration_s):
    states = [state_after(parameters, start, brake, duration_s, 0.001 / 2**k) for k in range(2, 6)]
    errors = [np.linalg.norm(coarse - fine) for coarse, fine in pairwise(states)]
    ratios = [coarse / fine for coarse, fine in pairwise(errors)]
    assert ratios == pytest.approx([4.0, 4.0], rel=0.15)


@pytest.mark.parametrize(
    ("start", "brake", "duration_s"),
    [((180.0 * ROLLING, 180.0), 1.0, 1.4), ((30.0, 30.0), 0.6, 1.0), ((20.0, 20.0), 0.5, 1.0)],
)
def test_halving_the_step_converges_down_to_standstill(parameters, start, brake, duration_s):
    states = [state_after(parameters, start, brake, duration_s, 0.001 / 2**k) for k in range(2, 6)]
    assert [list(state[:2]) for state in states] == [[0.0, 0.0]] * 4
    errors_rad = [np.linalg.norm(fine[2:] - coarse[2:]) for coarse, fine in pairwise(states)]
    assert errors_rad[0] < 2e-4
    assert [coarse / fine for coarse, fine in pairwise(errors_rad)] == pytest.approx([4.0, 4.0], rel=0.3)


@pytest.mark.parametrize("advance_s", [0.0001, 0.01])
@pytest.mark.long
def test_wheels_that_start_slowly_are_where_finer_steps_have_them(parameters, advance_s):
    """A mock board advances in short parts between exchanges, on which the angles must not depend."""

    def angles_rad(max_step_s):
        plant = Plant(parameters, 0.0, 0.0, max_step_s=max_step_s)
        for duty in (0.07, 0.0):
            for _ in range(round(0.3 / advance_s)):
                plant.advance(duty, 0.0, advance_s)
        return plant.wheel_angle, plant.road_angle

    assert min(angles_rad(0.0005)) > 0.03
    assert angles_rad(0.0005) == pytest.approx(angles_rad(0.0001), abs=1e-5)


@pytest.mark.parametrize("road_rad_s", [30.0, 10.0, 3.0, 1.0])
def test_standard_step_follows_the_stiff_contact_at_low_speed(parameters, road_rad_s):
    start = (0.9 * road_rad_s, road_rad_s)
    duration_s = 0.004 * max(1, round(road_rad_s / 60.0 / 0.004))
    coarse = state_after(parameters, start, 0.5, duration_s, 0.0005)
    fine = state_after(parameters, start, 0.5, duration_s, 0.00002)
    assert fine[1] > 0.25 * road_rad_s
    assert coarse[:2] == pytest.approx(fine[:2], rel=2e-4)


@pytest.mark.parametrize(
    ("start", "brake", "duration_s"),
    [
        ((0.95 * ROLLING * 150.0, 150.0), 0.65, 0.6),  # braking
        ((180.0, 180.0), 1.0, 0.3),  # from the wheel's faster rim through rolling to almost locked
        ((0.9 * ROLLING * 40.0, 40.0), 0.5, 0.4),  # stiff, low speed
        ((150.0, 100.0), 0.0, 0.3),  # the wheel drives the road
        ((-150.0, -100.0), 0.5, 0.3),  # backward, the wheel faster
        ((-80.0, -120.0), 0.5, 0.2),  # backward, the road faster
        ((-100.0, 100.0), 0.6, 0.15),  # opposite directions
        ((100.0, -100.0), 0.6, 0.15),
    ],
)
def test_plant_agrees_with_an_independent_integrator(parameters, paper, start, brake, duration_s):
    plant = Plant(parameters, *start)
    plant.advance(0.0, brake, duration_s)
    assert plant.wheel_speed * start[0] > 0.0
    assert plant.road_speed * start[1] > 0.0
    x1, x2, torque_nm, angle1_rad, angle2_rad = reference(paper, start, brake, duration_s)
    assert plant.wheel_speed == pytest.approx(x1, abs=4e-4)
    assert plant.road_speed == pytest.approx(x2, abs=4e-4)
    assert plant.brake_torque == pytest.approx(torque_nm, rel=1e-8)
    assert plant.wheel_angle == pytest.approx(angle1_rad, abs=1.5e-4)
    assert plant.road_angle == pytest.approx(angle2_rad, abs=1.5e-4)


def test_slip_of_a_whole_braking_trajectory_agrees_with_the_independent_integrator(mask, paper_of):
    k = replace(mask, c31=1 / 0.048)
    paper, start = paper_of(k), (0.98 * ROLLING * 180.0, 180.0)
    plant = Plant(k, *start)
    for step in range(1, 7):
        plant.advance(0.0, 1.0, 0.05)
        x1, x2 = reference(paper, start, 1.0, 0.05 * step)[:2]
        assert plant.slip == pytest.approx(paper.slip(x1, x2), abs=5e-6)
    assert 0.8 < plant.slip < 1.0


@pytest.mark.parametrize("max_step_s", [0.0005, 0.002, 0.01])
@pytest.mark.parametrize(
    ("start_rad_s", "brake", "steady_slip"), [(3.0, 0.0, 0.0020), (3.0, 0.45, 0.0097), (8.0, 0.5, 0.0159)]
)
def test_slip_stays_steady_down_to_standstill_at_any_step(mask, start_rad_s, brake, steady_slip, max_step_s):
    plant = Plant(mask, start_rad_s, start_rad_s, max_step_s=max_step_s)
    plant.advance(0.0, brake, 0.02)
    while plant.road_speed > 0.0:
        assert plant.time_s < 3.0
        assert plant.slip <= 1.02 * steady_slip
        plant.advance(0.0, brake, max_step_s)
    assert plant.wheel_speed == 0.0
