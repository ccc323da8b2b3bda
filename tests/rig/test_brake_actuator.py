import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.rig import Plant, brake_duty, brake_torque


@pytest.mark.parametrize(
    ("duty", "torque_nm"),
    [(1.0, 9.03), (0.7, 4.458), (0.415, 0.1146), (0.5, 1.41), (0.4149, 0.0), (0.2, 0.0), (0.0, 0.0)],
)
def test_static_map(parameters, duty, torque_nm):
    assert brake_torque(duty, parameters) == pytest.approx(torque_nm, rel=1e-12, abs=0.0)


def test_continuous_dead_zone_of_the_vendors_simulator_never_gives_negative_torque(parameters):
    continuous = replace(parameters, u0=0.40748031496063)
    assert brake_torque(0.40748031496063, continuous) == pytest.approx(0.0, abs=1e-12)
    early = replace(parameters, u0=0.3)
    assert brake_torque(0.35, early) == 0.0


@settings(deadline=None)
@given(duty=st.floats(0.415, 1.0))
def test_inverse_gives_back_the_duty(parameters, duty):
    assert brake_duty(brake_torque(duty, parameters), parameters) == pytest.approx(duty, rel=1e-13)


@settings(deadline=None)
@given(torque_nm=st.floats(0.115, 9.03))
def test_inverse_settles_to_the_torque_that_was_asked(parameters, torque_nm):
    duty = min(1.0, brake_duty(torque_nm, parameters))
    assert brake_torque(duty, parameters) == pytest.approx(torque_nm, rel=1e-12)


@pytest.mark.parametrize("torque_nm", [0.0, -0.0, -1.0, -9.03])
def test_no_torque_needs_no_duty(parameters, torque_nm):
    assert brake_duty(torque_nm, parameters) == 0.0


def test_inverse_is_not_limited(parameters):
    assert brake_duty(10.0, parameters) == pytest.approx(16.21 / 15.24, rel=1e-13)


@pytest.mark.parametrize("duration_s", [0.0005, 0.003, 0.0491, 0.2, 1.0])
@pytest.mark.parametrize("speed_rad_s", [0.0, 150.0])
def test_torque_follows_a_step_of_duty_by_an_exact_exponential(parameters, duration_s, speed_rad_s):
    plant = Plant(parameters, speed_rad_s, speed_rad_s)
    plant.advance(0.0, 0.7, duration_s)
    assert plant.brake_torque == pytest.approx(4.458 * (1.0 - math.exp(-20.37 * duration_s)), rel=1e-11)


def test_torque_decays_by_the_same_exponential(parameters):
    plant = Plant(parameters, 150.0, 150.0)
    plant.advance(0.0, 1.0, 0.05)
    rising_nm = plant.brake_torque
    plant.advance(0.0, 0.41, 0.03)
    assert plant.brake_torque == pytest.approx(rising_nm * math.exp(-20.37 * 0.03), rel=1e-11)


def test_torque_does_not_depend_on_the_integration_step(parameters):
    torques_nm = []
    for max_step_s in (0.005, 0.0005, 0.00013):
        plant = Plant(parameters, 150.0, 150.0, max_step_s=max_step_s)
        plant.advance(0.0, 0.8, 0.033)
        torques_nm.append(plant.brake_torque)
    assert torques_nm == pytest.approx([torques_nm[0]] * 3, rel=1e-12)


def test_dead_zone_gives_no_torque_in_time(parameters):
    plant = Plant(parameters, 150.0, 150.0)
    plant.advance(0.0, 0.4149, 0.5)
    assert plant.brake_torque == 0.0


def test_infinite_rate_makes_a_brake_that_follows_at_once(parameters):
    plant = Plant(replace(parameters, c31=math.inf), 150.0, 150.0)
    plant.advance(0.0, 0.7, 0.0005)
    assert plant.brake_torque == pytest.approx(4.458, rel=1e-12)
    plant.advance(0.0, 0.0, 0.0005)
    assert plant.brake_torque == 0.0
