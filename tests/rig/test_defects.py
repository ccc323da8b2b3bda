"""What real rigs have and the published one has not: each effect by itself."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.rig import Encoder, EncoderVariation, Plant, RigVariation, kinetic_energy, settled_torque
from inteco_abs.rig.variation import ROADS

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

TURN = 2.0 * math.pi
STEP_S = 0.0005


def braked(rig, seconds, duty=0.7, road_rad_s=180.0):
    """A plant that has rolled and then been braked for so long."""
    k = rig.parameters
    plant = Plant(rig, k.r2 / k.r1 * road_rad_s, road_rad_s)
    for _ in range(round(seconds / STEP_S)):
        plant.advance(0.0, duty, STEP_S)
    return plant


def standing(rig):
    return Plant(rig, 0.0, 0.0)


def test_the_brake_has_its_own_release_time():
    rig, lag_s = RigVariation(brake_release_ratio=3.0), 1.0 / RigVariation().parameters.c31
    plant = standing(rig)
    plant.advance(0.0, 0.7, lag_s)
    full = settled_torque(0.7, rig)
    assert plant.brake_torque == pytest.approx(full * (1.0 - math.exp(-1.0)), rel=1e-9)
    plant.advance(0.0, 0.7, 5.0)
    plant.advance(0.0, 0.0, 3.0 * lag_s)
    assert plant.brake_torque == pytest.approx(full * math.exp(-1.0), rel=1e-6)


def test_a_brake_with_dead_time_releases_in_its_own_time_too():
    rig, lag_s = RigVariation(brake_release_ratio=0.5, brake_dead_time_s=0.02), 1.0 / RigVariation().parameters.c31
    plant = standing(rig)
    plant.advance(0.0, 0.7, 5.0)
    plant.advance(0.0, 0.0, 0.02)
    assert plant.brake_torque == pytest.approx(settled_torque(0.7, rig), rel=1e-6)
    plant.advance(0.0, 0.0, 0.5 * lag_s)
    assert plant.brake_torque == pytest.approx(settled_torque(0.7, rig) * math.exp(-1.0), rel=1e-6)


@pytest.mark.parametrize(("dead_s", "delay_s", "acts_s"), [(0.02, 0.01, 0.03), (0.02, -0.01, 0.01), (0.0, 0.01, 0.01)])
def test_a_release_has_its_own_dead_time(dead_s, delay_s, acts_s):
    rig = RigVariation(brake_dead_time_s=dead_s, brake_release_delay_s=delay_s)
    plant = standing(rig)
    plant.advance(0.0, 0.7, 5.0)
    plant.advance(0.0, 0.0, acts_s)
    assert plant.brake_torque == pytest.approx(settled_torque(0.7, rig), rel=1e-6)
    plant.advance(0.0, 0.0, 1.0 / rig.parameters.c31)
    assert plant.brake_torque == pytest.approx(settled_torque(0.7, rig) * math.exp(-1.0), rel=1e-6)


@pytest.mark.parametrize(("delay_s", "duties"), [(-0.02, (0.7, 0.0)), (0.02, (0.0, 0.7))])
def test_the_newest_command_holds_even_if_it_overtakes_those_before(delay_s, duties):
    rig = RigVariation(brake_dead_time_s=0.02, brake_release_delay_s=delay_s)
    plant = standing(rig)
    plant.advance(0.0, 0.5, 5.0)
    for duty in duties:
        plant.advance(0.0, duty, 0.005)
    plant.advance(0.0, duties[-1], 5.0)
    assert plant.brake_torque == pytest.approx(settled_torque(duties[-1], rig), abs=1e-6)


def settled_after(rig, *duties):
    plant = standing(rig)
    for duty in duties:
        plant.advance(0.0, duty, 5.0)
    return plant.brake_torque


def test_hysteresis_is_as_wide_as_it_says_and_a_released_brake_is_open():
    rig, torque = RigVariation(brake_hysteresis_nm=0.4), settled_torque(0.7, RigVariation())
    assert settled_after(rig, 0.7) == pytest.approx(torque - 0.2)
    assert settled_after(rig, 1.0, 0.7) == pytest.approx(torque + 0.2)
    assert settled_after(rig, 1.0, 0.7, 0.71) == pytest.approx(torque + 0.2)  # inside the play nothing moves
    assert settled_after(rig, 1.0, 0.0) == pytest.approx(0.0, abs=1e-9)


def test_the_supply_voltage_sags_with_the_current():
    rig = RigVariation(supply_sag=0.1)
    assert settled_torque(0.8, rig) == settled_torque(0.8 - 0.1 * 0.8**2, RigVariation())
    assert settled_torque(0.0, rig) == 0.0


def test_a_hot_brake_has_less_torque_by_the_work_it_has_done():
    hot = braked(RigVariation(brake_fade_per_kj=2.0), 1.0)
    work_kj = hot.brake_work_kj
    assert 0.2 < work_kj < 0.45  # of the 0.54 kJ that both wheels had at first
    assert hot.brake_torque == pytest.approx(
        settled_torque(0.7, RigVariation()) / (1.0 + 2.0 * work_kj), rel=0.02
    )  # it lags


def test_fade_and_wear_never_go_back():
    plant = standing(RigVariation(brake_fade_per_kj=1.0, wheel_wear_per_kj=0.05))
    seen = []
    for tick in range(4000):
        plant.advance(1.0 if tick % 2000 < 1000 else 0.0, 0.0 if tick % 2000 < 1000 else 0.7, 0.002)
        seen.append((plant.fade, plant.wheel_radius))
    assert seen == sorted(seen, reverse=True)
    assert seen[-1][0] < 0.9
    assert plant.wheel_radius == pytest.approx(0.0995 * (1.0 - 0.05 * plant.brake_work_kj))


def test_a_worn_wheel_that_rolls_turns_faster():
    plant = braked(RigVariation(wheel_wear_per_kj=0.1), 0.8)
    plant.advance(0.0, 0.0, 1.0)
    assert plant.wheel_speed / plant.road_speed > 0.099 / plant.wheel_radius * 0.99
    assert plant.slip < 0.01


def test_the_road_changes_and_changes_back_within_a_stop():
    steps = {"grip_step": -0.5, "grip_step_after_s": 0.1, "second_grip_step": 0.2, "second_grip_step_after_s": 0.2}
    rig = RigVariation(**steps, third_grip_step=-0.2, third_grip_step_after_s=0.3)
    assert [braked(rig, seconds).grip for seconds in (0.05, 0.15, 0.25, 0.35)] == pytest.approx([1.0, 0.5, 1.2, 0.8])


def test_steps_come_in_the_order_of_their_times():
    rig = RigVariation(grip_step=-0.5, grip_step_after_s=0.3, second_grip_step=0.2, second_grip_step_after_s=0.1)
    assert [braked(rig, seconds).grip for seconds in (0.05, 0.15, 0.35)] == pytest.approx([1.0, 1.2, 0.5])


def test_the_next_run_up_takes_every_step_back():
    plant = braked(RigVariation(road="ice", later_road="snow", second_grip_step=0.3, second_grip_step_after_s=0.1), 0.2)
    assert (plant.grip, plant.road_c1) == (1.3, ROADS["snow"][0])
    plant.advance(0.5, 0.0, 0.01)
    assert (plant.grip, plant.road_c1) == (1.0, ROADS["ice"][0])


@pytest.mark.parametrize("road", [name for name in ROADS if name])
def test_a_road_has_its_published_curve_which_falls_on_all_but_ice(road):
    c1, c2, c3 = ROADS[road]
    plant = Plant(RigVariation(road=road), 0.5 * 0.099 / 0.0995 * 100.0, 100.0)
    assert plant.slip == pytest.approx(0.5)
    assert plant.adhesion == pytest.approx(c1 * (1.0 - math.exp(-0.5 * c2)) - 0.5 * c3)
    half, locked = (Plant(RigVariation(road=road), speed, 100.0).adhesion for speed in (50.0, 0.0))
    assert locked < half or (road == "ice" and locked == pytest.approx(half))


def test_on_snow_a_locked_wheel_stops_later_than_one_near_the_peak():
    locked, *others = (braked(RigVariation(road="snow"), 0.5, duty) for duty in (1.0, 0.5, 0.51, 0.52, 0.53, 0.54))
    assert locked.wheel_speed == 0.0
    assert locked.road_speed > min(plant.road_speed for plant in others if plant.wheel_speed > 0.0)


def test_half_the_step_gives_the_same_stop_on_a_steep_road():
    rig = RigVariation(road="wet-asphalt", adhesion_tilt=0.3)
    coarse, fine = (Plant(rig, 179.0, 180.0, max_step_s=step_s) for step_s in (0.0005, 0.00025))
    for _ in range(1500):
        for plant in (coarse, fine):
            plant.advance(0.0, 0.6, 0.0005)
    assert coarse.wheel_speed == pytest.approx(fine.wheel_speed, abs=0.02)


def test_a_tilt_raises_the_adhesion_above_a_fifth_of_slip_and_lowers_it_below():
    def at(slip, tilt):
        return Plant(RigVariation(adhesion_tilt=tilt), (1.0 - slip) * 0.099 / 0.0995 * 100.0, 100.0).adhesion

    assert at(0.2, 0.5) == pytest.approx(at(0.2, 0.0))
    assert at(0.6, 0.5) == pytest.approx(1.2 * at(0.6, 0.0))
    assert at(0.1, 0.5) == pytest.approx(0.95 * at(0.1, 0.0))


def test_a_drive_that_still_pulls_delays_the_stop_but_moves_no_rig_at_rest():
    rig = RigVariation(drive_residual_nm=0.08)
    assert braked(rig, 1.0).road_speed > braked(RigVariation(), 1.0).road_speed
    plant = standing(rig)
    plant.advance(0.0, 0.0, 10.0)
    assert (plant.road_speed, plant.road_angle) == (0.0, 0.0)


def test_a_drive_that_still_pulls_harder_than_friction_moves_the_rig_off():
    k = replace(RigVariation().parameters, M20=0.04)
    plant = standing(RigVariation(parameters=k, drive_residual_nm=0.08))
    plant.advance(0.0, 0.0, 1.0)
    ratio = k.r2 / k.r1
    inertia = k.J2 + ratio**2 * k.J1
    # viscous friction takes less than 2 % of so low a speed
    assert plant.road_speed == pytest.approx((0.08 - k.M20 - ratio * k.M10) / inertia, rel=0.02)


@given(
    st.builds(
        RigVariation,
        brake_release_ratio=st.floats(0.1, 10.0),
        brake_hysteresis_nm=st.floats(0.0, 2.0),
        brake_fade_per_kj=st.floats(0.0, 5.0),
        supply_sag=st.floats(0.0, 0.5),
        adhesion_tilt=st.floats(-1.0, 1.0),
        road=st.sampled_from(sorted(ROADS)),
        later_road=st.sampled_from(sorted(ROADS)),
        later_road_after_s=st.floats(0.0, 0.2),
        brake_dead_time_s=st.floats(0.0, 0.05),
        brake_release_delay_s=st.floats(-0.05, 0.05),
    ),
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8),
)
def test_without_drive_no_defect_creates_energy_or_turns_a_wheel_back(rig, duties):
    plant, before = Plant(rig, 99.0, 100.0), math.inf
    for duty in duties:
        plant.advance(0.0, duty, 0.05)
        energy = kinetic_energy(plant.wheel_speed, plant.road_speed, rig.parameters)
        assert energy <= before
        assert plant.wheel_speed >= 0.0 <= plant.road_speed
        assert plant.brake_torque >= 0.0
        before = energy


def disc_counts(disc, turns=3, per_turn=1000, seed=0):
    encoder = Encoder(RigVariation(wheel_encoder=disc, seed=seed), wheel=True)
    return [encoder.read(i * TURN / per_turn, 0.0) for i in range(turns * per_turn + 1)]


def test_a_second_harmonic_repeats_twice_per_turn():
    disc = EncoderVariation(2**16, second_harmonic_counts=50.0, second_harmonic_phase_rad=0.5)
    errors = [n - i * 2**16 / 1000 for i, n in enumerate(disc_counts(disc, turns=1))]
    assert max(errors) == pytest.approx(50.0, abs=1.5)
    assert errors[500] == pytest.approx(errors[0], abs=1.5)
    assert errors[250] == pytest.approx(-errors[0], abs=1.5)


def test_a_damaged_line_costs_its_counts_in_each_turn_at_its_place():
    whole, damaged = (disc_counts(EncoderVariation(2048, damaged_counts=n, damage_angle_rad=1.0)) for n in (0.0, 4.0))
    lost = [a - b for a, b in zip(whole, damaged, strict=True)]
    assert [lost[turn * 1000 + 170] - lost[turn * 1000 + 150] for turn in range(3)] == [4, 4, 4]
    assert damaged == sorted(damaged)


@given(st.floats(0.0, 0.05), st.floats(0.0, 1.0))
def test_lost_counts_are_that_share_and_the_counter_never_turns_back(share, edge):
    counts = disc_counts(EncoderVariation(2048, edge_counts=edge, lost_share=share), per_turn=2048)
    assert counts == sorted(counts)
    assert counts[-1] == pytest.approx(3 * 2048 * (1.0 - share), abs=3.0)


def test_latching_jitter_moves_both_wheels_by_the_same_time_and_nothing_at_rest():
    rig = RigVariation(latch_jitter_s=0.0002, seed=3)
    rig = replace(rig, wheel_encoder=EncoderVariation(10**6), road_encoder=EncoderVariation(10**6))
    wheel, road = Encoder(rig, wheel=True), Encoder(rig, wheel=False)
    read = [(wheel.read(0.0, 100.0), road.read(0.0, 50.0)) for _ in range(2000)]
    late_s = [first / 1e6 * TURN / 100.0 for first, _ in read]
    assert max(map(abs, late_s)) == pytest.approx(0.0002, rel=0.02)
    assert math.sqrt(sum(one * one for one in late_s) / 2000) == pytest.approx(0.0002 / math.sqrt(3.0), rel=0.05)
    assert all(abs(first - 2 * second) <= 2 for first, second in read)
    assert wheel.read(0.0, 0.0) == 0


def test_an_unknown_road_is_refused_by_name():
    with pytest.raises(ValueError, match="road = 'mud': must be one of '', 'dry-asphalt'"):
        RigVariation(road="mud")
