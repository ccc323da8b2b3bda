import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from inteco_abs.rig import DriveMotor, Plant, accelerations, kinetic_energy

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

moving_rad_s = st.floats(0.1, 300.0) | st.floats(-300.0, -0.1)
torques_nm = st.floats(0.0, 9.03)


def power_w(x1, x2, torque_nm, parameters):
    motion = accelerations(x1, x2, torque_nm, 0.0, parameters)
    return parameters.J1 * x1 * motion.wheel_acceleration + parameters.J2 * x2 * motion.road_acceleration


def closing(plant, paper, drive, brake, duration_s, sampling_s):
    """Loss of kinetic energy, and the dissipation less the drive's work, both in J."""
    before_j = kinetic_energy(plant.wheel_speed, plant.road_speed, plant.parameters)
    lost_w = []

    def note():
        x1, x2 = plant.wheel_speed, plant.road_speed
        driven_w = plant.motor.torque(drive, x2) * x2 if drive else 0.0
        lost_w.append(paper.dissipation_w(x1, x2, plant.brake_torque) - driven_w)

    note()
    for _ in range(round(duration_s / sampling_s)):
        plant.advance(drive, brake, sampling_s)
        note()
    after_j = kinetic_energy(plant.wheel_speed, plant.road_speed, plant.parameters)
    return before_j - after_j, float(np.trapezoid(lost_w, dx=sampling_s))


def test_kinetic_energy_is_that_of_both_wheels(mask):
    assert kinetic_energy(10.0, -20.0, mask) == pytest.approx((7.5281e-3 * 100 + 25.603e-3 * 400) / 2, rel=1e-14)


@settings(deadline=None)
@given(x1=moving_rad_s, x2=moving_rad_s, torque_nm=torques_nm)
def test_power_balance_of_every_instant(parameters, paper, x1, x2, torque_nm):
    lost_w = paper.dissipation_w(x1, x2, torque_nm)
    assert power_w(x1, x2, torque_nm, parameters) == pytest.approx(-lost_w, rel=1e-10, abs=1e-9)


@settings(deadline=None)
@given(x1=moving_rad_s, x2=moving_rad_s, torque_nm=torques_nm)
def test_power_is_never_positive_where_adhesion_is_not_negative(parameters, paper, x1, x2, torque_nm):
    assume(paper.mu(paper.slip(x1, x2)) >= 0.0)
    assert power_w(x1, x2, torque_nm, parameters) < 0.0


@pytest.mark.parametrize(
    ("wheel_rad_s", "road_rad_s", "brake", "duration_s"),
    [
        (140.0, 150.0, 0.65, 0.5),
        (170.0, 120.0, 0.0, 0.3),
        (-120.0, -100.0, 0.5, 0.3),
        (-100.0, 100.0, 0.6, 0.15),
    ],
)
def test_dissipation_over_time_is_the_kinetic_energy_lost(
    parameters, paper, wheel_rad_s, road_rad_s, brake, duration_s
):
    plant = Plant(parameters, wheel_rad_s, road_rad_s)
    lost_j, dissipated_j = closing(plant, paper, 0.0, brake, duration_s, 0.0005)
    assert plant.wheel_speed * wheel_rad_s > 0.0
    assert plant.road_speed * road_rad_s > 0.0
    assert lost_j > 5.0
    assert dissipated_j == pytest.approx(lost_j, rel=2e-5)


def test_energy_of_a_spin_up_is_the_drives_work_less_the_dissipation(parameters, paper):
    plant = Plant(parameters, 9.9, 10.0)
    lost_j, balance_j = closing(plant, paper, 0.9, 0.0, 2.0, 0.0005)
    assert lost_j < -40.0
    assert balance_j == pytest.approx(lost_j, rel=2e-5)


def test_energy_of_a_locked_stop_goes_into_rubbing_and_the_roads_bearing(parameters, paper):
    plant = Plant(parameters, 100.0, 120.0)
    while plant.wheel_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.001)
    k, locked_at_rad_s, locked_at_rad = parameters, plant.road_speed, plant.road_angle
    while plant.road_speed > 20.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.001)
    turned_rad = plant.road_angle - locked_at_rad
    rubbed_j = paper.locked_normal_force() * paper.mu(1.0) * k.r2 * turned_rad
    lost_j = kinetic_energy(0.0, locked_at_rad_s, k) - kinetic_energy(0.0, plant.road_speed, k)
    a, b = locked_at_rad_s, plant.road_speed
    mean_rad_s = 2 / 3 * (a**3 - b**3) / (a**2 - b**2)  # over the angle, for a constant deceleration
    viscous_j = k.d2 * turned_rad * mean_rad_s
    assert lost_j == pytest.approx(rubbed_j + k.M20 * turned_rad + viscous_j, rel=2e-5)


def test_a_drive_without_duty_does_no_work_in_either_direction():
    motor = DriveMotor()
    assert [motor.torque(0.0, speed_rad_s) for speed_rad_s in (-200.0, -1.0, 0.0, 1.0, 200.0)] == [0.0] * 5
