"""What predictive-reaching is certified for, compared with stops of simulated rigs."""

import csv
import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from inteco_abs.cli.command import cli
from inteco_abs.config import load_config
from inteco_abs.control import Observer, control_check, make_controller
from inteco_abs.control.estimators.braking_ekf import EkfTuning
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design import Brake, certify, stated_box
from inteco_abs.montecarlo import run_stops
from inteco_abs.rig import Plant, RigParameters, RigVariation, draw
from inteco_abs.signals import BoardFlags, Command, Sample

pytestmark = pytest.mark.untraced

MASK = RigParameters.named("mask")
SPEEDS = (35.0, 140.0)
ROLLING = 60
"""Ticks before the brake acts."""
HELD, SWINGS = 0.004, 0.012
"""RMS slip error of a stop that holds its reference, and of one that swings."""


def configured(*settings):
    names = ("controller.name=predictive-reaching", "estimator.name=observer", "controller.gains.swing_band=0")
    return load_config(settings=[*names, *settings], checks=[control_check()])


@cache
def certified(*settings, uncertain="mu=0%", brake=None):
    return certify(configured(*settings), stated_box([uncertain], MASK), SPEEDS, brake)


def borne():
    """The narrowest of each range over the speeds."""
    rows = certified().rows
    return {
        "gain": (max(row.least_gain for row in rows), min(row.most_gain for row in rows)),
        "later_s": (-min(row.earlier_s for row in rows), min(row.later_s for row in rows)),
        "lag_s": (max(row.least_lag_s for row in rows), min(row.most_lag_s for row in rows)),
    }


def slip_errors(gain=1.0, later_s=0.0, lag_s=0.05, radius=1.0):
    """Slip errors from 120 to 30 rad/s, by an observer that does not learn of the brake."""
    parameters = replace(MASK, c31=1.0 / lag_s, r1=MASK.r1 * radius)
    rig = RigVariation(parameters, brake_map="measured", brake_dead_time_s=0.01 + later_s, brake_gain=gain)
    config = configured()
    period_s, per_rad = config.period_ns * 1e-9, 2048 / (2.0 * math.pi)
    plant = Plant(rig, 180.0 * MASK.r2 / parameters.r1, 180.0)
    observer = Observer(MASK, 2048, period_s, EkfTuning(dead_time_sd_s=0.0, lag_sd_s=0.0))
    law, demanded, errors = make_controller(config), 0.0, []
    for tick in range(1, 4000):
        counts = math.floor(plant.wheel_angle * per_rad), math.floor(plant.road_angle * per_rad)
        command = Command(1.0 if tick < ROLLING else 0.0, demanded)
        estimate = observer.update(Sample(tick, tick * config.period_ns, period_s, *counts, BoardFlags.NONE), command)
        demanded = law.update(estimate, period_s).brake if tick >= ROLLING else 0.0
        plant.advance(0.3 if tick < ROLLING else 0.0, command.brake, period_s)
        if plant.road_speed < 120.0:
            errors.append(plant.slip - 0.2)
        if plant.road_speed < 30.0:
            return np.array(errors)
    raise AssertionError("no stop")


def rms(**brake):
    return float(np.sqrt(np.mean(slip_errors(**brake) ** 2)))


@pytest.mark.parametrize(
    ("name", "side"), [pytest.param("gain", 1, marks=pytest.mark.long), ("later_s", 1), ("lag_s", 0)]
)
def test_a_stop_holds_what_it_is_certified_for(name, side):
    assert rms(**{name: borne()[name][side]}) < HELD


@pytest.mark.long
@pytest.mark.parametrize(("name", "side", "times"), [("gain", 1, 1.3), ("later_s", 1, 2.0), ("lag_s", 0, 0.7)])
def test_a_stop_not_far_beyond_swings(name, side, times):
    assert rms(**{name: times * borne()[name][side]}) > SWINGS


def test_what_is_certified_together_holds_together():
    share, one = min(row.together for row in certified().rows), borne()
    for lag in one["lag_s"]:
        brake = {
            "gain": one["gain"][1] ** share,
            "later_s": share * one["later_s"][1],
            "lag_s": 0.05 * (lag / 0.05) ** share,
        }
        assert rms(**brake) < HELD
    assert 0.2 < share < 0.6


def test_other_radii_move_the_slip_by_what_is_said():
    off = np.mean(slip_errors(radius=0.99)) - np.mean(slip_errors())
    assert off == pytest.approx(-certified().slip_offset, rel=0.1)


@pytest.mark.long
def test_a_longer_dead_time_or_a_higher_gain_leaves_less():
    def least(*settings):
        return min(row.later_s for row in certified(*settings).rows)

    late = least("model.identified.brake_dead_time_s=0.03")
    assert 0.0 < late < least()
    assert least("controller.gains.k=120", "controller.gains.kM=800") < 0.7 * least()


@pytest.mark.long
def test_the_stated_set_is_judged_together():
    assert not certified(uncertain="brake_gain=10%").advice
    assert not certified(brake=Brake(0.045, 0.055, 0.011)).advice
    assert certified(uncertain="brake_gain=50%").advice
    (advice,) = certified(brake=Brake(0.02, 0.05, 0.011)).advice
    assert "not certified" in advice.found
    assert not any(certified(brake=Brake(0.0, 0.05, 0.011)).certified)
    assert certified(uncertain="g=85%", brake=Brake(0.05, 0.05, 0.01)).advice


@pytest.mark.long
def test_the_command_prints_the_ranges(tmp_path, capsys):
    words = ["design", "--controller", "predictive-reaching", "--uncertain", "mu=1%"]
    table = tmp_path / "loop.csv"
    assert cli.main([*words, "--json", "--csv", str(table)], standalone_mode=False) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["expected"] == {"least_lag_s": 0.05, "most_lag_s": 0.05, "dead_time_s": 0.01}
    assert all(0.003 < row["later_s"] < 0.01 and row["certified"] for row in report["loop"])
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [float(row["later_s"]) for row in rows] == [row["later_s"] for row in report["loop"]]
    assert cli.main([*words, "--lag", "0", "0.05"], standalone_mode=False) == 3
    assert "not certified" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (["--slip-band", "0.1", "0.3"], "--slip-band: belongs to laws with a switching gain"),
        (["--from-slip", "0.5"], "--from-slip: belongs to laws with a switching gain"),
        (["--speeds", "170", "180"], "the slip is not at its reference at these speeds"),
        (["--figure", "loop.png"], "has a table and no figure"),
        (["--dead-time", "0.02"], "needs --lag"),
    ],
)
def test_what_does_not_belong_to_it_is_refused(given, problem, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=problem):
        cli.main(["design", "--controller", "predictive-reaching", *given], standalone_mode=False)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_drawn_rigs_hold_up_to_the_range_of_the_longest_dead_time_that_is_learnt():
    """The observer takes at most 30 ms for possible."""
    longest_s = 0.03
    rows = certified(f"model.identified.brake_dead_time_s={longest_s}").rows
    later_s = min(row.later_s for row in rows)

    def median(dead_time_s):
        rigs = [replace(draw("hard", 1300000 + i), brake_dead_time_s=dead_time_s) for i in range(10)]
        stops = run_stops(rigs, configured())
        return float(np.median(stops["slip_rms_fixed_true"]))

    assert median(longest_s + later_s) < 0.01
    assert median(longest_s + 2.0 * later_s) > 0.015
