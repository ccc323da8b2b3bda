"""A reference slip that changes while braking: followed, recorded and replayed."""

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from inteco_abs.analysis import replay_session
from inteco_abs.analysis.compiled_replay import CompiledReplay
from inteco_abs.analysis.replay import decisions
from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS, build_pipeline, control_check, make_controller, reference_function
from inteco_abs.errors import ConfigError
from inteco_abs.format import TICK
from inteco_abs.plugins import Controllers, Origin
from inteco_abs.sessions import session_config
from inteco_abs.signals import Estimate, Phase

STEP = ("controller.reference_points=[0.1, 0.1, 0.3]", "controller.reference_at_s=[0.0, 0.2, 0.2]")
SINE = ("controller.reference_formula=0.2 + 0.05*sin(2*pi*t/0.1) - step(t, 0.15)*min(0.1, speed/900)",)
RAMP = ("controller.reference_points=[0.3, 0.1]", "controller.reference_at_rad_s=[20.0, 60.0]")
QUICK = ("experiment.start_speed_rad_s=70.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")
IDEAL_BRAKE = ("controller.name=boundary-layer", "estimator.name=kalman")


SETTINGS = Path(__file__).parents[2] / "docs/settings.md"
TABLE = re.findall(r"^\| (.+) \| (`reference_.*) \|$", SETTINGS.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize(("kind", "cells"), TABLE)
def test_every_kind_of_reference_on_the_settings_page_can_be_given(kind, cells, tmp_path):
    lines = re.findall(r"`([^`]+)`", cells)
    file = tmp_path / "rig.toml"
    file.write_text("\n".join(["[controller]", *lines]), encoding="utf-8")
    config = load_config(file, checks=[control_check()])
    options = [f"controller.{line.replace(' = ', '=', 1)}" for line in lines]
    assert load_config(settings=options, checks=[control_check()]) == config
    law = make_controller(config, CONTROLLERS)
    held = set()
    for tick in range(1200):
        law.update(Estimate(100.0 - tick / 15, 150.0 - tick / 10, 0.1, valid=True), 0.0005)
        held.add(round(reference_function(law)(law, 0.2), 3))
    assert (len(held) == 1) == (kind == "constant")


def test_the_settings_page_has_every_kind():
    assert len(TABLE) == 7


def braking_of(session):
    return session.ticks[session.ticks["phase"] == Phase.BRAKING]


def assert_replays_in_python(session):
    pipeline = build_pipeline(session_config(session, (control_check(),)), CONTROLLERS)
    assert replay_session(session, pipeline).differing == 0


def assert_replays(session):
    """In Python and compiled, with the bits of the run."""
    assert_replays_in_python(session)
    pipelines = [build_pipeline(session_config(session, (control_check(),)), CONTROLLERS) for _ in range(2)]
    compiled, python = (
        CompiledReplay(pipelines[0], may_compile=True).decide(session.ticks),
        decisions(session, pipelines[1]),
    )
    assert compiled is not None
    for column in TICK.columns:
        if column.role.value != "timing":
            assert compiled[column.name].tobytes() == python[column.name].tobytes(), column.name


def test_a_step_in_time_is_recorded_followed_in_every_stop_and_replayed(run_at, tmp_path):
    session = run_at(tmp_path / "step.mcap", (*QUICK, *STEP, *IDEAL_BRAKE, "experiment.stops=2")).session
    ticks = braking_of(session)
    starts = [0, *(np.flatnonzero(np.diff(ticks["time_ns"]) > 10_000_000) + 1), len(ticks)]
    assert len(starts) == 3
    for first, end in pairwise(starts):
        stop = ticks[first:end]
        since_s = (stop["time_ns"] - stop["time_ns"][0]) * 1e-9
        assert set(stop["slip_reference"][since_s < 0.199]) == {0.1}
        assert set(stop["slip_reference"][since_s > 0.202]) == {0.3}
        acting = since_s > 0.001
        assert np.array_equal(
            (stop["slip"] - stop["slip_reference"])[acting & (stop["road_speed_rad_s"] > 6.0)],
            stop["switching"][acting & (stop["road_speed_rad_s"] > 6.0)],
        )
    assert_replays_in_python(session)


@pytest.mark.long
def test_a_ramp_over_speed_is_that_of_the_estimated_speed(run_at, tmp_path):
    made = run_at(tmp_path / "ramp.mcap", (*QUICK, *RAMP, *IDEAL_BRAKE))
    ticks = braking_of(made.session)[1:]
    wanted = np.interp(ticks["road_speed_rad_s"], [20.0, 60.0], [0.3, 0.1])
    assert np.allclose(ticks["slip_reference"], wanted, rtol=0.0, atol=1e-12)
    assert_replays(made.session)


@pytest.mark.long
def test_a_formula_is_that_of_time_and_estimated_speed(run_at, tmp_path):
    made = run_at(tmp_path / "sine.mcap", (*QUICK, *SINE, *IDEAL_BRAKE))
    ticks = braking_of(made.session)[1:]  # the first demand follows the tick in which braking begins
    since_s, speed = (ticks["time_ns"] - ticks["time_ns"][0]) * 1e-9, ticks["road_speed_rad_s"]
    wanted = 0.2 + 0.05 * np.sin(2.0 * np.pi * since_s / 0.1) - (since_s >= 0.15) * np.minimum(0.1, speed / 900.0)
    near = np.abs(since_s - 0.15) > 0.001
    assert np.allclose(ticks["slip_reference"][near], wanted[near], rtol=0.0, atol=1e-12)
    assert made.session.metadata["controller"]["reference"] == SINE[0].partition("=")[2]
    assert_replays(made.session)


@pytest.mark.long
@pytest.mark.parametrize("start", [0.08, 0.4])
def test_a_search_ends_near_the_peak_of_the_road_and_replays(run_at, tmp_path, start):
    """Wet cobblestone: 0.4*(1 - exp(-33.7*slip)) - 0.12*slip has its peak at 0.14, and 99 % of it in 0.10 to 0.20."""
    cobbles = 'base = "hard"\n[rig]\nroad = "wet-cobblestone"\nadhesion_scale = 1.0\n'
    road = f"simulation.population={json.dumps(cobbles)}"
    settings = ("controller.reference_search=true", f"controller.reference_slip={start}")
    law = ("controller.name=predictive-reaching", "estimator.name=observer", "simulation.rig=cobbles.toml:3001", road)
    session = run_at(tmp_path / "search.mcap", (*QUICK, "experiment.start_speed_rad_s=150.0", *settings, *law)).session
    ticks = braking_of(session)
    late = ticks[ticks["road_speed_rad_s"] < 75.0]
    assert ticks["slip_reference"][1] == pytest.approx(start, abs=0.01)
    assert 0.10 < late["slip_reference"].mean() < 0.20
    assert_replays(session)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (STEP[:1], ["reference_points", "reference_at_s", "reference_at_rad_s"]),
        (STEP[1:], ["reference_points"]),
        ((STEP[0], "controller.reference_at_s=[0.0, 0.2]"), ["3 slips for 2 values"]),
        ((STEP[0], "controller.reference_at_s=[0.0, 0.3, 0.2]"), ["must rise"]),
        ((STEP[0], "controller.reference_at_s=[0.0, 0.1, 99.0]"), ["99"]),
        ((*SINE, *STEP), ["give only one of reference_points"]),
        ((*STEP, "controller.reference_search=true"), ["give only one of", "reference_search"]),
        (
            ("controller.reference_search=true", "controller.name=law.py:Law"),
            ["controller.reference_search: law.py:Law holds"],
        ),
        (("controller.reference_formula=0.2 +",), ["not a formula at character", "allowed are numbers"]),
        (("controller.reference_formula=__import__('os')",), ["__import__", "allowed are numbers"]),
        (("controller.reference_formula=0.2 + x",), ["'x' is not allowed"]),
        (("controller.reference_formula=t.real",), ["'t.real' is not allowed"]),
        (("controller.reference_formula=sin(t, t)",), ["sin with 2 arguments"]),
        ((f"controller.reference_formula={'+'.join(['t'] * 100)}",), ["199 steps: at most 128"]),
        (("controller.reference_formula=0.1*speed",), ["0 at t = 0 s and speed = 0 rad/s", "limit it"]),
        ((f"controller.reference_formula={'(' * 150}t{')' * 149}",), ["not a formula"]),
        ((*STEP, RAMP[1]), ["one of reference_at_s and reference_at_rad_s"]),
        ((*STEP, "controller.name=law.py:Law"), ["law.py:Law holds a constant slip only", "declare `reference = 0.0`"]),
    ],
)
def test_points_that_make_no_reference_are_refused(settings, words):
    class Law:
        gains = internals = ()

        def update(self, estimate, dt_s): ...

    with pytest.raises(ConfigError) as raised:
        load_config(settings=settings, checks=[control_check(Controllers({"law.py:Law": (Law, Origin())}))])
    assert all(word in str(raised.value) for word in words), raised.value


def test_a_published_law_follows_it():
    config = load_config(settings=(*STEP, "controller.name=lqr"), checks=[control_check(Controllers())])
    controller = make_controller(config, Controllers())
    for reference in (0.1, 0.3):
        demands = [controller.update(Estimate(88.0, 100.0, 0.12, valid=True), 0.0005) for _ in range(401)]
        assert demands[-2].switching == 0.12 - reference
