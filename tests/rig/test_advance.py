import math
from dataclasses import replace

import pytest

from inteco_abs.rig import Plant

STATE = ("wheel_speed", "road_speed", "wheel_angle", "road_angle", "brake_torque", "time_s")


def state_of(plant):
    return [getattr(plant, name) for name in STATE]


@pytest.mark.parametrize(
    ("start", "drive", "brake"),
    [((170.0, 180.0), 0.0, 0.8), ((0.0, 0.0), 1.0, 0.0), ((3.0, 3.0), 0.0, 0.6), ((-50.0, 80.0), 0.3, 1.0)],
)
def test_one_advance_of_10_ms_equals_20_of_half_a_millisecond(parameters, start, drive, brake):
    at_once, in_parts = Plant(parameters, *start), Plant(parameters, *start)
    for _ in range(30):
        at_once.advance(drive, brake, 0.01)
        for _ in range(20):
            in_parts.advance(drive, brake, 0.0005)
    assert state_of(at_once) == pytest.approx(state_of(in_parts), rel=1e-11, abs=1e-12)


def test_a_new_plant_starts_in_the_given_state_with_the_brake_released(parameters):
    plant = Plant(parameters, 12.0, 34.0)
    assert state_of(plant) == [12.0, 34.0, 0.0, 0.0, 0.0, 0.0]


def test_advance_by_nothing_changes_nothing(parameters):
    plant = Plant(parameters, 12.0, 34.0)
    plant.advance(1.0, 1.0, 0.0)
    assert state_of(plant) == [12.0, 34.0, 0.0, 0.0, 0.0, 0.0]


def test_advance_by_nothing_changes_nothing_where_the_brake_follows_at_once(parameters):
    plant = Plant(replace(parameters, c31=math.inf), 12.0, 34.0)
    plant.advance(0.0, 1.0, 0.0)
    assert state_of(plant) == [12.0, 34.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("duration_s", [1e-6, 0.00049, 0.0005, 0.00051, 0.0123, 1.0])
def test_time_moves_on_by_exactly_the_duration(parameters, duration_s):
    plant = Plant(parameters, 100.0, 110.0)
    plant.advance(0.0, 0.5, duration_s)
    assert plant.time_s == duration_s


def test_angles_are_the_integral_of_the_speeds(parameters):
    plant = Plant(parameters, 150.0, 160.0)
    wheel_rad = road_rad = 0.0
    for _ in range(400):
        wheel_rad += 0.0005 * plant.wheel_speed / 2
        road_rad += 0.0005 * plant.road_speed / 2
        plant.advance(0.0, 0.6, 0.0005)
        wheel_rad += 0.0005 * plant.wheel_speed / 2
        road_rad += 0.0005 * plant.road_speed / 2
    assert plant.wheel_angle == pytest.approx(wheel_rad, rel=1e-8)
    assert plant.road_angle == pytest.approx(road_rad, rel=1e-8)


def test_two_plants_of_one_parameter_set_do_not_touch_each_other(parameters):
    moved, left = Plant(parameters, 100.0, 100.0), Plant(parameters, 100.0, 100.0)
    moved.advance(0.0, 1.0, 0.1)
    assert state_of(left) == [100.0, 100.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("bad", [-0.001, 1.001, -1.0, math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("which", ["drive", "brake"])
def test_a_duty_outside_0_to_1_is_refused_and_nothing_moves(mask, which, bad):
    plant = Plant(mask, 100.0, 110.0)
    with pytest.raises(ValueError, match=rf"{which} {bad!r}.*0\.\.1"):
        plant.advance(**{"drive": 0.0, "brake": 0.0, which: bad}, duration_s=0.01)
    assert state_of(plant) == [100.0, 110.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("bad_s", [-1e-9, -1.0, math.nan, math.inf])
def test_a_duration_that_is_negative_or_not_finite_is_refused_and_nothing_moves(mask, bad_s):
    plant = Plant(mask, 100.0, 110.0)
    with pytest.raises(ValueError, match=rf"duration_s = {bad_s!r}"):
        plant.advance(0.0, 0.0, bad_s)
    assert state_of(plant) == [100.0, 110.0, 0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("speeds", [(math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0), (0.0, -math.inf)])
def test_speeds_that_are_not_finite_are_refused(mask, speeds):
    with pytest.raises(ValueError, match="must be finite"):
        Plant(mask, *speeds)


@pytest.mark.parametrize("bad_s", [0.0, -0.0005, math.nan, math.inf])
def test_a_step_that_is_not_positive_and_finite_is_refused(mask, bad_s):
    with pytest.raises(ValueError, match=rf"max_step_s = {bad_s!r}"):
        Plant(mask, 0.0, 0.0, max_step_s=bad_s)
