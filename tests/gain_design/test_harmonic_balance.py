"""Limit cycles of the real loop, compared with stops of simulated rigs."""

import json
import math
import random
from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.cli.command import cli
from inteco_abs.config import load_config
from inteco_abs.control import control_check
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design import Brake, judge_gains, stated_box
from inteco_abs.gain_design.harmonic_balance import law_gain, response
from inteco_abs.montecarlo import run_stops
from inteco_abs.rig import RigParameters, RigVariation

MASK = RigParameters.named("mask")
SPEEDS = (50.0, 70.0)
RIGS = [(0.013, 0.014), (0.022, 0.0075), (0.035, 0.0024), (0.05, 0.0073)]
"""Lag and dead time, s."""
LATE = Brake(0.035, 0.065, 0.015)
LAYER = "controller.name=boundary-layer"


def configured(*settings):
    return load_config(settings=settings, checks=[control_check()])


def judged(*settings, brake=LATE, speeds=SPEEDS):
    return judge_gains(configured(*settings), stated_box(["mu=0%"], MASK), speeds, brake=brake)


def swings(rigs, *settings):
    """Amplitude and frequency in Hz of each rig's slip while the road slows from 90 to 30 rad/s."""
    varied = [
        RigVariation(replace(MASK, c31=1.0 / lag_s), brake_dead_time_s=dead_time_s, command_delay_ticks=1)
        for lag_s, dead_time_s in rigs
    ]
    stops = run_stops(varied, configured(*settings), run_up_from_rad_s=None, traced=range(len(rigs)))
    for trace in (stops.traces[i] for i in range(len(rigs))):
        shown = (trace.road_speed_rad_s < 90.0) & (trace.road_speed_rad_s > 30.0) & (trace.time_s > 0.4)
        error = trace.slip[shown] - 0.2
        (rising,) = np.nonzero(np.diff(np.sign(error)) > 0.0)
        spans = len(rising) - 1
        frequency_hz = spans / np.ptp(trace.time_s[shown][rising]) if spans > 0 else 0.0
        yield math.sqrt(2.0 * np.mean(error**2)), frequency_hz


def test_a_switching_law_swings_as_far_and_as_fast_as_predicted():
    for (lag_s, dead_time_s), (amplitude, frequency_hz) in zip(RIGS, swings(RIGS), strict=True):
        row = judged(brake=Brake(lag_s, lag_s, dead_time_s)).balances[2]
        assert row.amplitude < amplitude < 1.3 * row.amplitude
        assert row.frequency_hz == pytest.approx(frequency_hz, rel=0.15)  # of three to five periods


@pytest.mark.long
def test_the_boundary_layer_that_is_advised_does_not_swing():
    brake = Brake(0.02, 0.06, 0.015)
    rigs = [(lag_s, brake.dead_time_s) for lag_s in (brake.least_lag_s, 0.04, brake.most_lag_s)]
    (advice,) = judged(brake=brake, speeds=(35.0, 180.0)).advice
    assert advice.about == "limit cycle"
    setting = f"controller.gains.{advice.next_step.rpartition('gains.')[2].replace(' ', '')}"
    assert not judged(LAYER, setting, brake=brake).advice
    advised, switching = (list(swings(rigs, *given)) for given in ((LAYER, setting), ()))
    for (layer, _), (without, _) in zip(advised, switching, strict=True):
        assert layer < 0.25 * without


@pytest.mark.long
def test_predictions_hold_on_a_hundred_rigs():
    draw = random.Random(7)
    rigs = [(draw.uniform(0.005, 0.065), draw.uniform(0.0, 0.015)) for _ in range(100)]
    predicted = [judged(brake=Brake(lag_s, lag_s, dead_time_s)).balances[2].amplitude for lag_s, dead_time_s in rigs]
    ratios = [amplitude / row for (amplitude, _), row in zip(swings(rigs), predicted, strict=True)]
    assert np.median(ratios) == pytest.approx(1.19, abs=0.04)
    assert 0.95 < min(ratios) < max(ratios) < 1.5
    layer = [amplitude for amplitude, _ in swings(rigs, LAYER, "controller.gains.width=0.08")]
    assert np.median(layer) < 0.0005
    assert max(layer) < 0.01


def test_a_layer_that_is_too_thin_swings_and_is_reported():
    thin = LAYER, "controller.gains.width=0.012"
    ((amplitude, _),) = swings([(0.05, 0.012)], *thin)
    row = judged(*thin, brake=Brake(0.05, 0.05, 0.012)).balances[2]
    assert row.delay_margin_s == 0.0
    assert row.amplitude < amplitude < 1.3 * row.amplitude


def test_a_loop_oscillates_once_its_delay_margin_is_used_up():
    layer = LAYER, "controller.gains.width=0.05"
    row = judged(*layer, brake=Brake(0.04, 0.04, 0.005)).balances[2]
    assert 0.01 < row.delay_margin_s < 0.1

    def swings_with(share):
        later = Brake(0.04, 0.04, 0.005 + share * row.delay_margin_s)
        return judged(*layer, brake=later).balances[2].amplitude > 0.0

    assert not swings_with(0.98)
    assert swings_with(1.02)


def test_less_delay_bears_more_gain():
    def most(lag_s, dead_time_s, *settings):
        return judged(*settings, brake=Brake(lag_s, lag_s, dead_time_s)).balances[2].most_gain_per_s

    assert most(0.0, 0.0) > most(0.02, 0.0) > most(0.02, 0.01) > most(0.05, 0.01)
    assert most(0.02, 0.01, "estimator.window_s=0.02") < most(0.02, 0.01)
    assert most(0.02, 0.01, "loop.rate_hz=250", "estimator.window_s=0.02") < most(0.02, 0.01, "estimator.window_s=0.02")
    assert most(0.02, 0.01, "controller.gains.lag_s=0.02") > most(0.02, 0.01)


def test_uncertain_gain_of_the_brake_leaves_less_room():
    def most(*uncertain):
        rows = judge_gains(configured(), stated_box(uncertain, MASK), SPEEDS, brake=Brake(0.05, 0.05, 0.01)).balances
        return rows[2].most_gain_per_s

    assert most("brake_gain=20%") < 0.9 * most("mu=0%")


@pytest.mark.parametrize("window_s", [0.005, 0.02])
def test_a_moving_window_delays_by_half_its_length(window_s):
    seen = response(configured(f"estimator.window_s={window_s}"), 0.2, 100.0, 30.0)
    assert seen.delay_s == pytest.approx(0.5 * window_s, abs=0.0003)
    assert 0.95 < seen.gain < 1.01


def test_coarse_counts_and_slow_wheels_are_seen_less_exactly():
    fine, coarse = (configured(f"encoders.counts_per_turn={counts}") for counts in (8192, 1024))
    assert response(coarse, 0.2, 100.0, 30.0).error > 4.0 * response(fine, 0.2, 100.0, 30.0).error
    assert response(fine, 0.2, 30.0, 30.0).error > 2.0 * response(fine, 0.2, 100.0, 30.0).error


def test_the_describing_function_of_a_layer_joins_gain_and_switching():
    layer, switch = (judged(*settings).case.gains for settings in ((LAYER, "controller.gains.width=0.05"), ()))
    assert law_gain(layer, 100.0, 0.0) == law_gain(layer, 100.0, 0.05) == pytest.approx(22.0)
    assert law_gain(layer, 100.0, 5.0) == pytest.approx(law_gain(switch, 100.0, 5.0), rel=1e-4)
    assert law_gain(switch, 100.0, 0.0) == math.inf


def test_an_estimator_that_models_the_brake_is_refused():
    with pytest.raises(ConfigError, match=r"estimator\.name.*'observer' models the brake itself"):
        judged("estimator.name=observer")


def test_the_command_reports_the_loop(capsys):
    code = cli.main(["design", "--uncertain", "mu=1%", "--lag", "0.035", "0.065", "--json"], standalone_mode=False)
    report = json.loads(capsys.readouterr().out)
    assert code == 3
    assert report["brake"] == {"least_lag_s": 0.035, "most_lag_s": 0.065, "dead_time_s": 0.0}
    assert [one["about"] for one in report["advice"]] == ["limit cycle"]
    assert all(row["amplitude"] > 0.0 for row in report["loop"])
    cli.main(["design", "--uncertain", "mu=1%", "--lag", "0.035", "0.065"], standalone_mode=False)
    assert "a second" in capsys.readouterr().out


IDENTIFIED = """
[model.identified]
c31 = 20.0
brake_dead_time_s = 0.01
brake_release_ratio = 2.0
brake_release_delay_s = 0.004
"""


def test_the_brake_of_an_identified_rig_is_judged_unless_another_is_stated(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(IDENTIFIED)

    def reported(*stated):
        command = ["design", "--config", str(tmp_path / "rig.toml"), "--uncertain", "mu=1%", "--json", *stated]
        cli.main(command, standalone_mode=False)
        return json.loads(capsys.readouterr().out)["brake"]

    assert reported() == pytest.approx({"least_lag_s": 0.05, "most_lag_s": 0.1, "dead_time_s": 0.014})
    assert reported("--dead-time", "0.02")["dead_time_s"] == 0.02
    assert reported("--lag", "0.03", "0.04") == {"least_lag_s": 0.03, "most_lag_s": 0.04, "dead_time_s": 0.0}
    assert reported("--set", "estimator.name=observer") is None


@pytest.mark.parametrize(
    ("given", "problem"),
    [(["--dead-time", "0.01"], "needs --lag"), (["--lag", "0.06", "0.03"], "must not fall; write --lag 0.03 0.06")],
)
def test_a_brake_that_is_stated_wrongly_is_refused(given, problem):
    with pytest.raises(ConfigError, match=problem):
        cli.main(["design", *given], standalone_mode=False)
