import math
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.rig import Plant, kinetic_energy

pytestmark = pytest.mark.untraced

COUNT_RAD = 2 * math.pi / 4096
CREEP_RAD_S = 0.005

duties = st.sampled_from([0.0, 0.415, 1.0]) | st.floats(0.0, 1.0)
durations_s = st.sampled_from([0.0005, 0.003, 0.01]) | st.floats(0.0, 0.02)
speeds_rad_s = (
    st.sampled_from([0.0, 180.0, -180.0, 1e-3, 1e-9, -1e-6]) | st.floats(0.001, 260.0) | st.floats(-260.0, -0.001)
)
forward_rad_s = st.sampled_from([0.0, 180.0, 1e-3, 1e-9]) | st.floats(0.001, 260.0)
bounded = settings(max_examples=max(20, settings().max_examples))
costly = settings(max_examples=max(8, settings().max_examples // 5))
ROUNDED = 1 + 4 * sys.float_info.epsilon
"""An energy is a sum of two products: nearly no time, 1e-16 s, may change its last digit."""


@bounded
@given(
    start=st.tuples(speeds_rad_s, speeds_rad_s),
    pushes=st.lists(st.tuples(duties, duties, durations_s), max_size=12),
)
def test_any_duties_leave_a_finite_state_and_slip_and_torque_in_range(parameters, start, pushes):
    plant = Plant(parameters, *start)
    for drive, brake, duration_s in pushes:
        plant.advance(drive, brake, duration_s)
        assert abs(plant.wheel_speed) < 320.0
        assert abs(plant.road_speed) < 320.0
        assert math.isfinite(plant.wheel_angle)
        assert math.isfinite(plant.road_angle)
        assert 0.0 <= plant.slip <= 1.0
        assert 0.0 <= plant.brake_torque <= 9.03 + 1e-9


@bounded
@given(start=st.tuples(speeds_rad_s, speeds_rad_s), pushes=st.lists(st.tuples(duties, durations_s), max_size=12))
def test_energy_never_grows_with_the_drive_off(parameters, start, pushes):
    plant = Plant(parameters, *start)
    energy_j = kinetic_energy(*start, parameters)
    for brake, duration_s in pushes:
        plant.advance(0.0, brake, duration_s)
        left_j = kinetic_energy(plant.wheel_speed, plant.road_speed, parameters)
        assert left_j <= energy_j * ROUNDED
        energy_j = left_j


@bounded
@given(
    start=st.tuples(forward_rad_s, forward_rad_s),
    pushes=st.lists(st.tuples(duties, durations_s), max_size=12),
)
def test_forward_wheels_never_turn_back_with_the_drive_off(parameters, start, pushes):
    plant = Plant(parameters, *start)
    for brake, duration_s in pushes:
        before = (plant.wheel_angle, plant.road_angle)
        plant.advance(0.0, brake, duration_s)
        assert plant.wheel_speed >= 0.0
        assert plant.road_speed >= 0.0
        assert plant.wheel_angle > before[0] - COUNT_RAD / 1000
        assert plant.road_angle > before[1] - COUNT_RAD / 1000


@costly
@given(drive=duties, brake=duties)
def test_the_drive_never_turns_resting_wheels_backward(parameters, drive, brake):
    plant = Plant(parameters, 0.0, 0.0)
    for _ in range(4):
        plant.advance(drive, brake, 0.01)
        assert plant.wheel_speed > -CREEP_RAD_S
        assert plant.road_speed > -CREEP_RAD_S
        assert plant.wheel_angle > -COUNT_RAD
        assert plant.road_angle > -COUNT_RAD


@costly
@given(speed_rad_s=st.floats(1e-9, 2.0), brake=duties)
def test_wheels_left_alone_come_to_rest_and_stay(parameters, speed_rad_s, brake):
    plant = Plant(parameters, speed_rad_s, speed_rad_s)
    plant.advance(0.0, brake, 0.8)
    assert (plant.wheel_speed, plant.road_speed) == (0.0, 0.0)
