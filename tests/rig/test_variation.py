import math
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.boards.frame_board import widths
from inteco_abs.rig import (
    POPULATIONS,
    Plant,
    RigVariation,
    adhesion,
    brake_torque,
    draw,
    measured_duty,
    measured_torque,
    settled_torque,
)
from inteco_abs.signals import Command

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

STATE = ("wheel_speed", "road_speed", "wheel_angle", "road_angle", "brake_torque")
MEASURED = [(0.45, 0.17), (0.526, 1.40), (0.58, 2.84), (0.70, 4.83), (0.85, 5.97), (1.0, 9.37)]


def state_of(plant):
    return [getattr(plant, name) for name in STATE]


def stop(rig, ticks=3000, **settings):
    """State every 100 ticks of a stop with a brake that comes and goes."""
    plant, states = Plant(rig, 179.0, 180.0, **settings), []
    for tick in range(ticks):
        plant.advance(0.0, 0.7 if tick % 300 < 200 else 0.5, 0.0005)
        if tick % 100 == 99:
            states.append(state_of(plant))
    return states


def settling_torque(rig, duty):
    """Torque of the brake a long time after a step of the duty."""
    plant = Plant(rig, 0.0, 0.0)
    plant.advance(0.0, duty, 5.0)
    return plant.brake_torque


def at_once(**changed):
    """A rig whose brake has no lag."""
    return RigVariation(replace(RigVariation().parameters, c31=math.inf), **changed)


def locked_road_rad_s2(rig, angle_rad=0.0, road_rad_s=100.0):
    """Deceleration of the road under a locked wheel."""
    plant = Plant(rig, 0.0, road_rad_s)
    plant.wheel_angle = angle_rad
    plant.advance(0.0, 1.0, 1e-5)
    assert plant.wheel_speed == 0.0
    return (road_rad_s - plant.road_speed) / 1e-5


def test_a_variation_without_changes_is_the_published_rig(mask):
    assert stop(RigVariation()) == stop(mask)


def test_a_future_change_alters_no_digit_before_it(mask):
    assert stop(RigVariation(grip_step=0.2, grip_step_after_s=60.0)) == stop(mask)


def test_other_parameters_are_other_parameters(parameters):
    assert stop(RigVariation(parameters)) == stop(parameters)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("adhesion_scale", 0.0),
        ("adhesion_blend", 1.01),
        ("brake_gain", math.nan),
        ("brake_duty_offset", -0.21),
        ("brake_dead_time_s", -0.001),
        ("brake_duty_cap", 1.1),
        ("brake_pwm_steps", -1),
        ("load_ripple", 0.6),
        ("load_ripple_phase_rad", math.inf),
        ("grip_step", -0.95),
        ("grip_step_after_s", math.inf),
        ("command_delay_ticks", 9),
        ("seed", -1),
        ("brake_map", "curve"),
    ],
)
def test_values_out_of_range_are_refused_by_name(name, bad):
    with pytest.raises(ValueError, match=rf"{name} = {bad!r}: must be"):
        replace(RigVariation(), **{name: bad})


@pytest.mark.parametrize(("duty", "torque_nm"), MEASURED)
def test_measured_map_passes_through_its_points(duty, torque_nm):
    assert measured_torque(duty) == pytest.approx(torque_nm, rel=1e-14)
    assert settling_torque(RigVariation(brake_map="measured"), duty) == pytest.approx(torque_nm, rel=1e-9)


def test_measured_map_is_straight_between_its_points_and_flat_beyond():
    assert measured_torque(0.725) == pytest.approx(0.5 * (4.83 + 5.62))
    assert [measured_torque(duty) for duty in (0.0, 0.4, 0.415)] == [0.0, 0.0, 0.0]
    assert measured_torque(1.02) == 9.37
    assert np.all(np.diff([measured_torque(duty) for duty in np.linspace(0.42, 1.0, 500)]) > 0.0)


@pytest.mark.parametrize("kind", ["line", "measured"])
def test_gain_multiplies_the_torque_and_the_offset_moves_the_duty(mask, kind):
    rig = RigVariation(brake_map=kind, brake_gain=1.05, brake_duty_offset=0.02)
    plain = measured_torque(0.62) if kind == "measured" else brake_torque(0.62, mask)
    assert settled_torque(0.64, rig) == pytest.approx(1.05 * plain, rel=1e-12)
    assert settling_torque(rig, 0.64) == pytest.approx(1.05 * plain, rel=1e-9)


def test_the_cap_limits_the_duty(mask):
    assert settling_torque(RigVariation(brake_duty_cap=0.7), 1.0) == pytest.approx(brake_torque(0.7, mask), rel=1e-9)


@pytest.mark.parametrize("steps", [255, 4095])
def test_pwm_steps_are_those_of_the_board(mask, steps):
    rig = RigVariation(brake_pwm_steps=steps)
    for duty in np.linspace(0.45, 1.0, 200):
        width = widths(Command(0.0, float(duty)), steps)[1]
        assert settled_torque(float(duty), rig) == pytest.approx(brake_torque(width / steps, mask), rel=1e-12)


@pytest.mark.parametrize("tick_s", [0.0005, 0.0013, 0.02])
def test_a_command_acts_a_dead_time_later_at_any_tick(mask, tick_s):
    late, plain = Plant(RigVariation(brake_dead_time_s=0.0105), 150.0, 150.0), Plant(mask, 150.0, 150.0)
    plain.advance(0.0, 0.0, 0.0105)
    plain.advance(0.0, 0.7, 0.04)
    plain.advance(0.0, 0.5, 0.0495)
    for duty, until_s in ((0.7, 0.04), (0.5, 0.1)):
        while late.time_s < until_s - 1e-9:
            late.advance(0.0, duty, min(tick_s, until_s - late.time_s))
        if duty == 0.7:
            assert late.brake_torque > 0.0
    assert late.time_s == pytest.approx(0.1)
    assert late.brake_torque == pytest.approx(plain.brake_torque, rel=1e-9)
    assert late.road_speed == pytest.approx(plain.road_speed, rel=1e-6)


def test_nothing_happens_within_the_dead_time():
    plant = Plant(RigVariation(brake_dead_time_s=0.02), 150.0, 150.0)
    plant.advance(0.0, 1.0, 0.0199)
    assert plant.brake_torque == 0.0
    plant.advance(0.0, 1.0, 0.0002)
    assert plant.brake_torque > 0.0


@pytest.mark.parametrize("angle_rad", [0.0, 1.0, 4.0])
def test_ripple_multiplies_the_normal_force_once_per_turn_of_the_wheel(mask, paper_of, angle_rad):
    rig = at_once(load_ripple=0.03, load_ripple_phase_rad=0.4)
    k, mu = mask, adhesion(1.0, mask)
    arm = k.L * (math.sin(k.phi_rad) - mu * math.cos(k.phi_rad)) / (1.0 + 0.03 * math.sin(angle_rad + 0.4))
    normal_n = k.Mg / (arm - k.r1 * mu)
    wanted = (normal_n * k.r2 * mu + k.d2 * 100.0 + k.M20) / k.J2
    assert locked_road_rad_s2(rig, angle_rad) == pytest.approx(wanted, rel=1e-4)
    assert locked_road_rad_s2(at_once()) == pytest.approx(
        (paper_of(k).locked_normal_force() * k.r2 * mu + k.d2 * 100.0 + k.M20) / k.J2, rel=1e-4
    )


def test_ripple_follows_the_wheel_and_not_the_road():
    plant, plain = (Plant(RigVariation(load_ripple=share), 100.0, 130.0) for share in (0.3, 0.0))
    gaps = []
    for _ in range(500):
        for rig in (plant, plain):
            rig.wheel_speed, rig.road_speed = 100.0, 130.0
            rig.advance(0.0, 0.0, 0.0005)
        gaps.append(plant.wheel_speed - plain.wheel_speed)
    turns = plant.wheel_angle / (2.0 * math.pi)
    rises = sum(before < 0.0 <= after for before, after in pairwise(gaps))
    assert rises == pytest.approx(turns, abs=1.0)
    assert max(gaps) == pytest.approx(-min(gaps), rel=0.35)


def test_grip_steps_after_braking_began_and_ends_with_the_drive(mask):
    rig = at_once(grip_step=-0.2, grip_step_after_s=0.1003)
    plant = Plant(rig, 0.0, 170.0)
    decelerations = []
    for _ in range(400):
        before = plant.road_speed
        plant.advance(0.0, 1.0, 0.0005)
        decelerations.append((before - plant.road_speed) / 0.0005)
    steps = [later / earlier for earlier, later in pairwise(decelerations)]
    assert steps[:199] == pytest.approx([1.0] * 199, abs=1e-3)

    def road_nm(grip):
        k, mu = mask, grip * adhesion(1.0, mask)
        arm = k.L * (math.sin(k.phi_rad) - mu * math.cos(k.phi_rad)) - k.r1 * mu
        return k.Mg / arm * k.r2 * mu + k.M20 + k.d2 * plant.road_speed

    assert decelerations[202] / decelerations[198] == pytest.approx(road_nm(0.8) / road_nm(1.0), rel=1e-3)
    shares = (decelerations[200] - decelerations[202]) / (decelerations[198] - decelerations[202])
    assert shares == pytest.approx(0.6, abs=0.01)  # the step comes 0.3 ms after that tick began
    plant.advance(0.5, 1.0, 0.0005)
    before = plant.road_speed
    plant.advance(0.0, 1.0, 0.0005)
    assert (before - plant.road_speed) / 0.0005 == pytest.approx(decelerations[198], rel=0.01)


@pytest.mark.parametrize("population", POPULATIONS)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_halving_the_step_converges_for_drawn_rigs_down_to_standstill(population, seed):
    rig = draw(population, seed)
    states = []
    for max_step_s in (0.0005, 0.00025, 0.000125):
        plant = Plant(rig, 179.0, 180.0, max_step_s=max_step_s)
        for tick in range(600):
            plant.advance(0.0, 0.55 if tick < 300 else 0.7, 0.005)
        states.append(state_of(plant))
    assert [state[:2] for state in states] == [[0.0, 0.0]] * 3
    errors_rad = [math.dist(coarse[2:4], fine[2:4]) for coarse, fine in pairwise(states)]
    assert errors_rad[0] < 0.02
    assert errors_rad[1] < 0.5 * errors_rad[0]


def test_every_default_that_the_plant_looks_at_makes_it_plain():
    assert RigVariation().plain_plant
    others = {"brake_map": "measured", "brake_pwm_steps": 255, "brake_duty_cap": 0.7, "drive_residual_nm": 0.05}
    others |= {"road": "ice", "later_road": "ice", "wheel_wear_per_kj": 0.01}
    ignored = {
        "parameters",
        "load_ripple_phase_rad",
        "grip_step_after_s",
        "second_grip_step",
        "third_grip_step",
        "later_road_after_s",
        "latch_jitter_s",
        "wheel_encoder",
        "road_encoder",
        "command_delay_ticks",
        "seed",
    }
    for name in {field.name for field in fields(RigVariation)} - ignored:
        assert not replace(RigVariation(), **{name: others.get(name, 0.11)}).plain_plant


@given(st.floats(1e-6, 9.369))
def test_the_measured_map_is_inverted(torque):
    assert measured_torque(measured_duty(torque)) == pytest.approx(torque, rel=1e-9, abs=1e-9)


def test_beyond_the_measured_map_the_duty_is_zero_or_one_and_nan_stays_nan():
    assert [measured_duty(torque) for torque in (-1.0, 0.0, 9.37, 50.0)] == [0.0, 0.0, 1.0, 1.0]
    assert math.isnan(measured_duty(math.nan))
