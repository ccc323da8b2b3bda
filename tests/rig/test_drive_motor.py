import pytest

from inteco_abs.rig import DriveMotor, Plant


def test_torque_is_a_straight_line_from_stall_to_no_load():
    motor = DriveMotor(stall_torque_nm=2.0, no_load_speed_rad_s=200.0)
    assert motor.torque(1.0, 0.0) == 2.0
    assert motor.torque(1.0, 100.0) == pytest.approx(1.0)
    assert motor.torque(0.5, 0.0) == 1.0
    assert motor.torque(0.5, 50.0) == pytest.approx(0.5)


def test_torque_never_brakes():
    motor = DriveMotor(stall_torque_nm=2.0, no_load_speed_rad_s=200.0)
    assert motor.torque(1.0, 250.0) == 0.0
    assert motor.torque(0.2, 50.0) == 0.0


def test_full_duty_can_reach_the_over_speed_limit(mask):
    plant = Plant(mask, 200.0, 200.0)
    plant.advance(1.0, 0.0, 15.0)
    assert plant.road_speed > 245.0


def test_another_motor_may_be_fitted(mask):
    weak = Plant(mask, 0.0, 0.0, DriveMotor(stall_torque_nm=0.09))
    weak.advance(1.0, 0.0, 0.1)
    assert weak.road_speed == 0.0
    strong = Plant(mask, 0.0, 0.0, DriveMotor(stall_torque_nm=3.0))
    strong.advance(1.0, 0.0, 0.1)
    assert strong.road_speed > 0.0
