"""The observer for any brake and tyre: what it learns in the run-up, and the dead time that it finds."""

from dataclasses import replace

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import control_check, make_estimator, preferred_estimator
from inteco_abs.rig import EncoderVariation, RigVariation, draw
from inteco_abs.signals import Command

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

DRIVE = Command(1.0, 0.0)
CONFIG = load_config(
    settings=["controller.name=predictive-reaching", "estimator.name=adaptive-observer"],
    checks=[control_check()],
    follows=preferred_estimator(),
)


def driven(rolling, rig, name="adaptive-observer", ticks=1200, speed_rad_s=120.0):
    """A rig that is driven from there on for 0.6 s."""
    estimator = make_estimator(replace(CONFIG, estimator=replace(CONFIG.estimator, name=name)))
    run = rolling(rig, speed_rad_s, observer=estimator)
    for _ in range(ticks):
        run.tick(lambda _seen: DRIVE)
    return run


@pytest.mark.parametrize("ratio", [0.96, 0.99, 1.01, 1.04])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_ratio_of_the_radii_is_learnt_while_the_wheels_roll(rolling, seed, ratio):
    rig = draw("hard", seed)
    rig = replace(rig, parameters=replace(rig.parameters, r1=ratio * rig.parameters.r1))
    assert driven(rolling, rig).observer.ekf.radius_ratio == pytest.approx(ratio, abs=0.0012)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_published_radii_stay_the_published_ones(rolling, seed):
    assert driven(rolling, draw("hard", seed)).observer.ekf.radius_ratio == 1.0


def test_only_the_adaptive_one_learns(rolling):
    rig = RigVariation(replace(RigVariation().parameters, r1=0.0956))
    assert driven(rolling, rig, "observer").observer.ekf.radius_ratio == 1.0


def test_slip_and_speeds_are_those_of_the_wheel_that_is_there(rolling):
    run = driven(rolling, RigVariation(replace(RigVariation().parameters, r1=0.0956)))
    for _ in range(600):
        seen = run.tick(lambda _seen: Command(0.0, 0.6))
    assert seen.slip == pytest.approx(run.plant.slip, abs=0.003)
    assert seen.wheel_speed_rad_s == pytest.approx(run.plant.wheel_speed, abs=0.5)


def test_a_disc_that_errs_twice_per_turn_is_learnt(rolling):
    disc = EncoderVariation(2048, second_harmonic_counts=1.0, second_harmonic_phase_rad=0.7)
    run = driven(rolling, RigVariation(wheel_encoder=disc))
    per_count = 2.0 * 3.141592653589793 / 2048
    wheel = run.observer.wheel
    assert 0.7 * per_count < (wheel.cosine_2**2 + wheel.sine_2**2) ** 0.5 < 1.1 * per_count
    assert abs(run.observer.road.cosine_2) < 0.1 * per_count


@pytest.mark.parametrize("dead_time_s", [0.02, 0.035, 0.05, 0.2])
def test_a_dead_time_far_from_the_expected_one_is_found_by_its_onset(rolling, dead_time_s):
    run = driven(rolling, RigVariation(brake_dead_time_s=dead_time_s, brake_map="measured"))
    for _ in range(round((dead_time_s + 0.04) * 2000)):
        seen = run.tick(lambda _seen: Command(0.0, 0.7))
    assert seen.outlook.brake_dead_time_s == pytest.approx(dead_time_s, abs=0.012)


def test_no_dead_time_is_longer_than_the_longest_that_is_taken_for_possible(rolling):
    config = replace(CONFIG, estimator=replace(CONFIG.estimator, longest_dead_time_s=0.06))
    rig = RigVariation(brake_dead_time_s=0.1, brake_map="measured")
    run = rolling(rig, 120.0, observer=make_estimator(config))
    for ticks, command in ((1200, DRIVE), (280, Command(0.0, 0.7))):
        for _ in range(ticks):
            seen = run.tick(lambda _seen, command=command: command)
    assert seen.outlook.brake_dead_time_s <= 0.06


@pytest.mark.parametrize("dead_time_s", [0.0, 0.005])
@pytest.mark.parametrize("speed_rad_s", [60.0, 120.0])
def test_the_slip_by_a_brake_without_lag_is_known_after_40_ms(rolling, dead_time_s, speed_rad_s):
    quick = replace(RigVariation().parameters, c31=1e6)
    rig = RigVariation(quick, brake_dead_time_s=dead_time_s, brake_map="measured")
    run = driven(rolling, rig, speed_rad_s=speed_rad_s)
    for _ in range(80):
        seen = run.tick(lambda _seen: Command(0.0, 1.0))
    assert seen.slip == pytest.approx(run.plant.slip, abs=0.006)


@pytest.mark.parametrize(("lag_s", "expected_s"), [(1e-6, 0.002), (0.005, 0.006), (0.015, 0.015)])
def test_lag_of_a_quick_brake_shows_in_how_fast_the_wheel_leaves_rolling(rolling, lag_s, expected_s):
    quick = replace(RigVariation().parameters, c31=1.0 / lag_s)
    run = driven(rolling, RigVariation(quick, brake_dead_time_s=0.005, brake_map="measured"), speed_rad_s=120.0)
    seen = [run.tick(lambda _seen: Command(0.0, 1.0)).outlook for _ in range(70)]
    assert seen[10].brake_lag_s == pytest.approx(0.05, abs=0.01)
    assert seen[-1].brake_lag_s == pytest.approx(expected_s, abs=0.006)
    assert seen[-1].brake_dead_time_s == pytest.approx(0.005, abs=0.003)


@pytest.mark.parametrize(("lag_s", "most"), [(1e-6, 1.2), (0.005, 1.6)])
def test_a_quick_brake_is_expected_to_release_quickly(rolling, lag_s, most):
    quick = replace(RigVariation().parameters, c31=1.0 / lag_s)
    run = driven(rolling, RigVariation(quick, brake_dead_time_s=0.005, brake_map="measured"), speed_rad_s=120.0)
    seen = [run.tick(lambda _seen: Command(0.0, 1.0)).outlook for _ in range(70)]
    assert seen[10].brake_release_ratio == pytest.approx(1.9, abs=0.1)
    assert 1.0 <= seen[-1].brake_release_ratio < most


def test_a_brake_without_dead_time_is_found_by_an_onset_that_comes_early(rolling):
    run = driven(rolling, RigVariation(brake_dead_time_s=0.0, brake_map="measured"), speed_rad_s=120.0)
    for _ in range(160):
        seen = run.tick(lambda _seen: Command(0.0, 1.0))
    assert seen.outlook.brake_dead_time_s < 0.006
    assert seen.outlook.brake_lag_s == pytest.approx(1.0 / RigVariation().parameters.c31, abs=0.015)


@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_a_slow_release_is_distinguished_from_a_slow_rise(rolling, ratio):
    rig = RigVariation(brake_dead_time_s=0.01, brake_map="measured", brake_release_ratio=ratio)
    run = driven(rolling, rig)
    assert run.observer.learnt == {}
    for duty in (0.8, 0.0, 0.8, 0.0):
        for _ in range(120):
            seen = run.tick(lambda _seen, duty=duty: Command(0.0, duty))
    learnt = run.observer.learnt
    assert learnt["brake_release_ratio"] == pytest.approx(ratio, rel=0.25)
    assert learnt["brake_dead_time_s"] == seen.outlook.brake_dead_time_s == pytest.approx(0.01, abs=0.003)
    assert 1.0 / learnt["c31"] == pytest.approx(seen.outlook.brake_lag_s) == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize(("fade_per_kj", "least", "most"), [(0.0, 0.0, 0.0001), (1.0, 0.0003, 0.0011)])
def test_the_fade_of_the_brake_is_learnt_from_its_loss_of_torque(rolling, fade_per_kj, least, most):
    rig = RigVariation(brake_dead_time_s=0.01, brake_map="measured", brake_fade_per_kj=fade_per_kj)
    run = driven(rolling, rig, speed_rad_s=165.0)
    for _ in range(1200):
        run.tick(lambda _seen: Command(0.0, 0.65))
    assert least <= run.observer.ekf.fade < most
    assert driven(rolling, rig).observer.ekf.fade == 0.0
