import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from inteco_abs.rig import (
    POPULATIONS,
    Plant,
    RigVariation,
    brake_duty,
    draw,
    holding_torque,
    settled_torque,
    torque_margin,
)

SEEDS = st.integers(0, (1 << 64) - 1)
MANY = range(1000)


def within(value, middle, share):
    return (1.0 - share) * middle <= value <= (1.0 + share) * middle


@given(seed=SEEDS, population=st.sampled_from(["hard", "rough", "late", "slow", "capped"]))
def test_every_draw_lies_within_its_populations_ranges(mask, seed, population):
    rig = draw(population, seed)
    k = rig.parameters
    assert all(within(getattr(k, name), getattr(mask, name), 0.05) for name in ("J1", "J2", "Mg"))
    assert all(within(getattr(k, name), getattr(mask, name), 0.2) for name in ("d1", "d2"))
    varied = {"J1", "J2", "Mg", "d1", "d2", "c31"}
    assert replace(k, **{name: getattr(mask, name) for name in varied}) == mask
    assert 0.035 <= 1.0 / k.c31 <= 0.065000001
    assert within(rig.adhesion_scale, 1.0, 0.15)
    assert 0.0 <= rig.adhesion_blend <= 1.0
    assert rig.brake_map == "measured"
    assert within(rig.brake_gain, 1.0, 0.05)
    assert abs(rig.brake_duty_offset) <= 0.02
    assert (rig.brake_dead_time_s == 0.02) if population == "slow" else (0.005 <= rig.brake_dead_time_s <= 0.015)
    assert rig.brake_duty_cap == (0.7 if population == "capped" else 1.0)
    assert rig.brake_pwm_steps == 255
    assert rig.command_delay_ticks == 1
    for disc in (rig.wheel_encoder, rig.road_encoder):
        assert (disc.counts_per_turn, disc.eccentricity_counts, disc.jitter_counts) == (2048, 0.5, 0.3)
        assert 0.0 <= disc.eccentricity_phase_rad <= 2.0 * math.pi
    if population in {"rough", "late"}:
        assert 0.0 <= rig.load_ripple <= 0.03
        assert abs(rig.grip_step) <= 0.2
        assert (rig.grip_step == 0.0) == (rig.grip_step_after_s == 0.0)
        low, high = (0.2, 0.7) if population == "rough" else (0.7, 1.0)
        assert rig.grip_step == 0.0 or low <= rig.grip_step_after_s <= high
        assert population == "rough" or rig.grip_step != 0.0
    else:
        assert rig.load_ripple == rig.grip_step == 0.0


@given(seed=SEEDS)
def test_a_nominal_rig_is_the_papers(mask, seed):
    rig = draw("nominal", seed)
    assert rig.plain_plant
    assert rig.parameters == replace(mask, c31=math.inf)
    assert rig.wheel_encoder == rig.road_encoder == RigVariation().wheel_encoder
    assert rig.command_delay_ticks == 0


@given(seed=SEEDS, population=st.sampled_from(POPULATIONS))
def test_a_seed_gives_the_same_rig_again(seed, population):
    assert draw(population, seed) == draw(population, seed)


def test_a_seed_gives_the_rig_that_it_always_gave():
    rig = draw("rough", 2026)
    assert (rig.parameters.J1, rig.adhesion_scale, rig.brake_dead_time_s, rig.grip_step, rig.load_ripple) == (
        0.007511639563678375,
        1.0150675972629473,
        0.00562664047958124,
        -0.058348917423102636,
        0.02063017544892921,
    )


@pytest.mark.parametrize("population", ["hard", "rough", "late", "slow", "capped"])
def test_no_two_seeds_give_the_same_rig(population):
    seeds = [*MANY, *(1 << bit for bit in range(10, 64))]
    drawn = {replace(draw(population, seed), seed=0) for seed in seeds}
    assert len(drawn) == len(seeds)


@given(seed=SEEDS)
def test_one_seed_is_one_rig_in_all_populations(seed):
    hard, rough = draw("hard", seed), draw("rough", seed)
    assert draw("slow", seed) == replace(hard, brake_dead_time_s=0.02)
    assert draw("capped", seed) == replace(hard, brake_duty_cap=0.7)
    step = {"grip_step": 0.0, "grip_step_after_s": 0.0}
    assert replace(rough, load_ripple=0.0, load_ripple_phase_rad=0.0, **step) == hard
    assert replace(draw("late", seed), **step) == replace(rough, **step)


@pytest.mark.parametrize(
    ("low", "high", "value"),
    [
        (0.95, 1.05, lambda rig: rig.parameters.J1 / 7.5281e-3),
        (0.95, 1.05, lambda rig: rig.parameters.J2 / 25.603e-3),
        (0.95, 1.05, lambda rig: rig.parameters.Mg / 19.6181),
        (0.8, 1.2, lambda rig: rig.parameters.d1 / 1.2e-4),
        (0.8, 1.2, lambda rig: rig.parameters.d2 / 2.25e-4),
        (0.035, 0.065, lambda rig: 1.0 / rig.parameters.c31),
        (0.85, 1.15, lambda rig: rig.adhesion_scale),
        (0.0, 1.0, lambda rig: rig.adhesion_blend),
        (0.95, 1.05, lambda rig: rig.brake_gain),
        (-0.02, 0.02, lambda rig: rig.brake_duty_offset),
        (0.005, 0.015, lambda rig: rig.brake_dead_time_s),
        (0.0, 2.0 * math.pi, lambda rig: rig.wheel_encoder.eccentricity_phase_rad),
        (0.0, 2.0 * math.pi, lambda rig: rig.road_encoder.eccentricity_phase_rad),
        (0.0, 0.03, lambda rig: rig.load_ripple),
    ],
)
def test_values_are_spread_evenly_over_their_range(low, high, value):
    shares = [(value(draw("rough", seed)) - low) / (high - low) for seed in MANY]
    assert kstest(shares, "uniform").pvalue > 0.001


def test_the_roads_force_steps_in_half_of_the_rough_draws_up_and_down():
    steps = [draw("rough", seed).grip_step for seed in MANY]
    assert sum(step != 0.0 for step in steps) == pytest.approx(500, abs=50)
    assert sum(step > 0.0 for step in steps) == pytest.approx(250, abs=45)


def test_an_unknown_population_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="'soft': must be one of nominal, hard, rough, late, slow, capped"):
        draw("soft", 1)


@pytest.mark.parametrize("population", POPULATIONS)
def test_a_seed_that_is_not_a_64_bit_word_is_refused(population):
    with pytest.raises(ValueError, match="seed = -1"):
        draw(population, -1)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("road_rad_s", [20.0, 60.0, 170.0])
def test_holding_torque_holds_the_slip_of_the_rig_itself(seed, road_rad_s):
    hard = draw("hard", seed)
    rig = RigVariation(
        replace(hard.parameters, c31=math.inf), adhesion_scale=hard.adhesion_scale, adhesion_blend=hard.adhesion_blend
    )
    k = rig.parameters
    drifts = []
    for excess_nm in (-0.2, 0.0, 0.2):
        plant = Plant(rig, 0.8 * k.r2 / k.r1 * road_rad_s, road_rad_s)
        duty = brake_duty(holding_torque(rig, 0.2, road_rad_s) + excess_nm, k)
        plant.advance(0.0, duty, 1e-4)
        drifts.append(plant.slip - 0.2)
    assert drifts[0] < 0.0 < drifts[2]
    assert abs(drifts[1]) < 1e-3 * drifts[2]


@pytest.mark.parametrize(("slip", "speed"), [(0.0, 100.0), (1.0, 100.0), (0.2, 0.0)])
def test_holding_torque_has_a_meaning_only_within_a_rolling_stop(slip, speed):
    with pytest.raises(ValueError, match="the slip must be above 0 and below 1, the speed above 0"):
        holding_torque(RigVariation(), slip, speed)


def test_torque_to_spare_is_the_least_over_the_speeds():
    rig = draw("capped", 3)
    margins = [settled_torque(1.0, rig) - holding_torque(rig, 0.2, speed) for speed in range(10, 181, 5)]
    assert torque_margin(rig) == pytest.approx(min(margins), rel=1e-12)


def test_about_one_capped_rig_in_six_cannot_hold_the_slip_and_no_uncapped_one():
    margins = [torque_margin(draw("capped", seed)) for seed in MANY]
    assert sum(margin < 0.0 for margin in margins) == pytest.approx(1000 / 6, abs=40)
    assert min(torque_margin(draw("hard", seed)) for seed in MANY) > 2.0
