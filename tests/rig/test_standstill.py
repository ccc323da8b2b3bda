from dataclasses import replace

import pytest

from inteco_abs.rig import Plant, accelerations


def full_stop_until_locked(parameters):
    plant = Plant(parameters, 180.0 * parameters.r2 / parameters.r1, 180.0)
    while plant.wheel_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.0005)
    return plant


@pytest.mark.parametrize("road_rad_s", [180.0, 20.0, 0.5])
def test_locked_wheel_carries_the_reaction_torque_and_not_the_brakes(parameters, paper, road_rad_s):
    motion = accelerations(0.0, road_rad_s, 9.03, 0.0, parameters)
    assert motion.wheel_acceleration == 0.0
    assert motion.slip == 1.0
    assert motion.normal_force == pytest.approx(paper.locked_normal_force(), rel=1e-12)
    assert motion.normal_force == accelerations(0.0, road_rad_s, 5.0, 0.0, parameters).normal_force


def test_locked_wheel_breaks_loose_where_the_road_puts_in_more_than_the_brake_holds(parameters, paper):
    k = parameters
    reaction_nm = paper.locked_normal_force() * k.r1 * paper.mu(1.0)
    assert accelerations(0.0, 100.0, reaction_nm * 1.0001 - k.M10, 0.0, k).wheel_acceleration == 0.0
    held_nm = reaction_nm * 0.9
    motion = accelerations(0.0, 100.0, held_nm - k.M10, 0.0, k)
    normal_n = (k.Mg + held_nm) / paper.lever(0.0, 100.0)
    assert motion.normal_force == pytest.approx(normal_n, rel=1e-12)
    assert motion.wheel_acceleration == pytest.approx((normal_n * k.r1 * paper.mu(1.0) - held_nm) / k.J1, rel=1e-11)
    assert motion.wheel_acceleration > 0.0


def test_locked_wheel_on_a_road_turning_back_is_pushed_back(parameters, paper):
    k = parameters
    motion = accelerations(0.0, -100.0, 0.5, 0.0, k)
    normal_n = (k.Mg - 0.5 - k.M10) / paper.lever(0.0, -100.0)
    assert motion.normal_force == pytest.approx(normal_n, rel=1e-12)
    assert motion.wheel_acceleration == pytest.approx((0.5 + k.M10 - normal_n * k.r1 * paper.mu(1.0)) / k.J1, rel=1e-11)
    assert motion.wheel_acceleration < 0.0
    assert accelerations(0.0, -100.0, 9.03, 0.0, k).wheel_acceleration == 0.0


def test_locked_wheel_stays_at_exactly_zero_until_the_road_stands(parameters):
    plant = full_stop_until_locked(parameters)
    assert plant.road_speed > 100.0
    locked_at_rad = plant.wheel_angle
    while plant.road_speed > 0.0:
        assert plant.time_s < 3.0
        plant.advance(0.0, 1.0, 0.0005)
        assert plant.wheel_speed == 0.0
        assert plant.slip == (1.0 if plant.road_speed > 0.0 else 0.0)
    assert plant.wheel_angle == locked_at_rad


def test_released_wheel_is_taken_along_again(parameters):
    plant = full_stop_until_locked(parameters)
    plant.advance(0.0, 0.0, 0.4)
    assert plant.brake_torque < 0.01
    assert plant.slip < 0.02
    assert plant.wheel_speed > 50.0


def test_both_wheels_at_rest_stay_at_exactly_zero(parameters):
    plant = Plant(parameters, 0.0, 0.0)
    for brake in (0.0, 0.5, 1.0, 0.0):
        plant.advance(0.0, brake, 0.1)
    assert (plant.wheel_speed, plant.road_speed, plant.wheel_angle, plant.road_angle) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.untraced
def test_a_stop_ends_at_exactly_zero_and_stays_there(parameters):
    plant = Plant(parameters, 10.0, 10.0)
    plant.advance(0.0, 0.6, 1.0)
    stopped = (plant.wheel_angle, plant.road_angle)
    assert (plant.wheel_speed, plant.road_speed) == (0.0, 0.0)
    plant.advance(0.0, 0.6, 1.0)
    assert (plant.wheel_speed, plant.road_speed) == (0.0, 0.0)
    assert (plant.wheel_angle, plant.road_angle) == stopped


def test_road_at_rest_stays_below_the_drives_breakaway(parameters):
    plant = Plant(parameters, 0.0, 0.0)
    plant.advance(0.99 * parameters.M20 / plant.motor.stall_torque_nm, 0.0, 1.0)
    assert (plant.wheel_speed, plant.road_speed, plant.road_angle) == (0.0, 0.0, 0.0)


@pytest.mark.untraced
@pytest.mark.parametrize("above", [1.1, 1.5, 2.0, 5.0])
def test_both_wheels_roll_off_together_above_the_drives_breakaway(parameters, above):
    k = parameters
    plant = Plant(k, 0.0, 0.0)
    ratio = k.r2 / k.r1
    friction_nm = k.M20 + k.M10 * ratio
    plant.advance(above * friction_nm / plant.motor.stall_torque_nm, 0.0, 0.2)
    rolling_rad_s2 = (above - 1.0) * friction_nm / (k.J2 + k.J1 * ratio**2)
    assert plant.road_speed == pytest.approx(0.2 * rolling_rad_s2, rel=0.15)
    assert plant.wheel_speed == pytest.approx(0.2 * rolling_rad_s2 * ratio, rel=0.15)


def test_drive_of_one_instant_is_held_or_not_by_the_roads_static_friction(parameters):
    k = parameters
    assert accelerations(0.0, 0.0, 0.0, 0.99 * k.M20, k).road_acceleration == 0.0
    assert accelerations(0.0, 0.0, 0.0, k.M20 + 0.5, k).road_acceleration == pytest.approx(0.5 / k.J2, rel=1e-12)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_road_at_rest_is_moved_by_a_spinning_wheel_unless_held(mask, paper_of, direction):
    x1 = direction * 100.0
    normal_n = paper_of(mask).normal_force(x1, 0.0, 0.0)
    contact_nm = normal_n * mask.r2 * paper_of(mask).mu(1.0)
    motion = accelerations(x1, 0.0, 0.0, 0.0, mask)
    assert motion.road_acceleration == pytest.approx(direction * (contact_nm - mask.M20) / mask.J2, rel=1e-11)
    stiff = replace(mask, M20=contact_nm * 1.01)
    assert accelerations(x1, 0.0, 0.0, 0.0, stiff).road_acceleration == 0.0


@pytest.mark.untraced
def test_locked_wheel_holds_the_road_against_the_drive(parameters):
    plant = Plant(parameters, 0.0, 0.0)
    plant.advance(0.0, 1.0, 0.5)
    plant.advance(1.0, 1.0, 1.0)
    assert plant.wheel_speed == 0.0
    assert plant.road_speed == pytest.approx(0.0, abs=1e-4)
    assert plant.road_angle == pytest.approx(0.0, abs=1e-4)


def test_a_wheel_turning_backwards_passes_through_zero_and_speeds_up(parameters):
    plant = Plant(parameters, -100.0, 100.0)
    turned_back = False
    while plant.wheel_speed <= 0.0:
        assert plant.time_s < 3.0
        turned_back |= plant.wheel_speed < 0.0
        assert plant.slip == 1.0
        plant.advance(0.0, 0.0, 0.0005)
    assert turned_back
    assert plant.time_s < 1.0
    plant.advance(0.0, 0.0, 0.5)
    assert plant.slip < 0.01
