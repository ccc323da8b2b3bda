"""The predictive controller on sampled rigs, and the oracle.

Of seeds that nothing was tuned on.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.config import load_config
from inteco_abs.control import control_check, preferred_estimator
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.montecarlo import Oracle, run_stops
from inteco_abs.rig import POPULATIONS, draw, settled_torque

FIRST = 100_000
ACTUATOR = ("band_entry_s", "stop_time_s", "stop_distance_m")
OURS = "controller.name=predictive-reaching"
SLOWER = ("experiment.start_speed_rad_s=100",)


def configured(*settings):
    return load_config(settings=settings, checks=[control_check()], follows=preferred_estimator())


def draws(population, count):
    return [draw(population, seed) for seed in range(FIRST, FIRST + count)]


def stops_of(population, count, *settings):
    stops = run_stops(draws(population, count), configured(*settings))
    assert set(stops.errors) == {""}
    return stops


def require_targets(stops, median_rms):
    assert np.median(stops["slip_rms_true"]) <= median_rms
    assert stops["lock_fraction"].max() == 0.0
    assert stops["band_entry_s"].max() <= 0.2
    assert stops["overshoot"].max() < 0.02


@pytest.mark.long
@pytest.mark.untraced
def test_the_slip_of_a_hard_rig_is_held_to_a_thousandth_and_a_half():
    require_targets(stops_of("hard", 4, OURS), 0.0015)


@pytest.mark.untraced
@pytest.mark.long
def test_20_ms_of_dead_time_are_tolerated():
    require_targets(stops_of("slow", 3, OURS), 0.0015)


@pytest.mark.untraced
@pytest.mark.long
@pytest.mark.parametrize(("population", "median_rms"), [("hard", 0.0012), ("slow", 0.0013), ("rough", 0.0025)])
def test_targets_hold_on_many_rigs(population, median_rms):
    require_targets(stops_of(population, 30, OURS), median_rms)


@pytest.mark.untraced
@pytest.mark.long
def test_error_is_a_tenth_of_the_papers_laws_at_most_on_every_rig():
    ours, papers = (stops_of("hard", 10, f"controller.name={name}") for name in ("predictive-reaching", "reaching-law"))
    assert (ours["slip_rms_true"] < papers["slip_rms_true"] / 10.0).all()


# the oracle


@pytest.mark.untraced
@pytest.mark.long
def test_what_the_oracle_knows_halves_the_error():
    config = configured(OURS)
    rigs = draws("hard", 2)
    ours, oracle = run_stops(rigs, config), run_stops(rigs, config, maker=Oracle(config))
    assert set(oracle.errors) == {""}
    assert (oracle["slip_rms_true"] < 0.5 * ours["slip_rms_true"]).all()
    assert (oracle["overshoot"] < 0.001).all()


@pytest.mark.long
@pytest.mark.parametrize("rig", [draw("nominal", FIRST), replace(draw("late", FIRST), grip_step_after_s=0.3)])
def test_the_oracle_brakes_a_rig_without_lag_and_one_whose_road_steps(rig):
    config = configured(OURS, *SLOWER)
    oracle = run_stops([rig], config, maker=Oracle(config), run_up_from_rad_s=95.0)
    assert oracle.errors == ("",)
    assert oracle["slip_rms_true"][0] < 0.005


class _Resting:
    wheel_speed = road_speed = slip = wheel_angle = brake_torque = 0.0
    fade = 1.0


@given(st.sampled_from(POPULATIONS), st.integers(0, 1000), st.floats(0.01, 1.0))
def test_the_oracle_has_the_brakes_map(population, seed, share):
    rig = replace(draw(population, seed), brake_pwm_steps=0, brake_duty_cap=1.0)
    highest, lowest = settled_torque(1.0, rig), settled_torque(rig.parameters.u0 + 1e-9, rig)
    wanted = lowest + share * (highest - lowest)
    _, controller = Oracle(configured(OURS))(rig, _Resting())
    assert settled_torque(controller.duty(wanted), rig) == pytest.approx(wanted, rel=1e-6)
    assert controller.duty(0.0) == 0.0


# the whole stack: frames, guard, sequence, and a run-up from rest


def on_the_stack(folder, count, *settings):
    """Result cards of the same rigs behind a mock board."""
    for seed in range(FIRST, FIRST + count):
        config = configured(*settings, f"simulation.rig=hard:{seed}")
        yield run_stop(config, Plan(folder / f"{seed}.mcap", seed=1)).card


def ratios(folder, count, *settings, run_up_from_rad_s=165.0):
    """Medians on the stack, as a share of those of the ensemble."""
    stops = run_stops(draws("hard", count), configured(*settings), run_up_from_rad_s=run_up_from_rad_s)
    cards = list(on_the_stack(folder, count, *settings))
    assert {card["outcome"] for card in cards} == {"completed"}
    names = (*ACTUATOR, "slip_rms_true")
    return {name: float(np.median([card[name] for card in cards]) / np.median(stops[name])) for name in names}


@pytest.mark.untraced
@pytest.mark.long
def test_the_whole_stack_gives_what_the_ensemble_gives(tmp_path):
    found = ratios(tmp_path, 1, OURS, *SLOWER, run_up_from_rad_s=85.0)
    assert [found[name] for name in ACTUATOR] == pytest.approx([1.0] * 3, abs=0.03)
    assert found["slip_rms_true"] == pytest.approx(1.0, abs=0.5)  # of 0.001: which noise it is makes as much


@pytest.mark.untraced
@pytest.mark.long
@pytest.mark.parametrize(
    ("settings", "of_rms"),
    [
        (("controller.name=reaching-law",), 0.05),
        (("controller.name=boundary-layer", "estimator.name=kalman", "controller.gains.Mk=10"), 0.05),
    ],
)
def test_a_virtual_run_reproduces_the_baselines_medians(tmp_path, settings, of_rms):
    found = ratios(tmp_path, 5, *settings)
    assert found == pytest.approx(dict.fromkeys(found, 1.0), abs=of_rms)


@pytest.mark.untraced
@pytest.mark.long
def test_virtual_runs_reproduce_the_medians_and_the_slip(tmp_path):
    """From rest the run-up is longer, and the discs are known better."""
    found = ratios(tmp_path, 20, OURS)
    assert [found[name] for name in ACTUATOR] == pytest.approx([1.0] * 3, abs=0.02)
    assert 0.75 < found["slip_rms_true"] < 1.1
