"""A drawn rig is recorded as by the plan, from a lower speed, and identified."""

import json
import math
import re
import tomllib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tracing import untraced

from inteco_abs.api.identify import law_sections, with_identified
from inteco_abs.cli.command import cli
from inteco_abs.config import IdentifiedConfig, ModelConfig, load_config
from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import ConfigError
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.identification import chosen, experiments, next_runs, segments
from inteco_abs.identification import identify as fitted
from inteco_abs.identification.parameters import ASSUMED, Priors
from inteco_abs.identification.simulation import angles
from inteco_abs.rig import RigParameters, draw, nominal_brake_map, nominal_parameters, settled_torque
from inteco_abs.sessions import read_session

RIG = draw("hard", 3)
"""Its discs are off centre by half a count, and not bent."""
RECORDED = ("coast", "stop-060", "stop-070")
PWM_STEPS = 255

pytestmark = pytest.mark.xdist_group("identify")


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    """Paths by name; short, because the runs begin at 60 rad/s."""
    folder = tmp_path_factory.mktemp("identify")
    files = {}
    for each in experiments(1.0):
        if each.name in RECORDED:
            slower = ("experiment.start_speed_rad_s=60", "simulation.rig=hard:3", *each.settings)
            files[each.name] = folder / f"{each.name}.mcap"
            assert untraced(run_stop, load_config(settings=slower), Plan(files[each.name])).outcome == "completed"
    return files


def identify(*arguments):
    return cli.main(["identify", *map(str, arguments)], standalone_mode=False)


def set_model(numbers):
    return [word for name, value in numbers.items() for word in ("--set", f"model.identified.{name}={value}")]


def parts_of(files):
    return chosen(part for file in files for part in segments(read_session(file), 2048))


@pytest.fixture(scope="module")
def found(sessions):
    return fitted(parts_of(sessions.values()), ModelConfig())


@pytest.fixture(scope="module")
def identified(sessions, found):
    """Estimates by name, and the parameter file."""
    out = next(iter(sessions.values())).with_name("rig.toml")
    out.write_text(found.to_toml())
    report = found.report()
    assert report["converged"]
    return {each["name"]: each for each in report["estimates"]}, out


def test_other_radii_leave_what_is_assumed_at_its_values():
    base = RigParameters.named("mask")
    priors = Priors(base, (0.6,), ASSUMED)
    start = [each.start for each in priors.fit_parameters]
    start[[each.name for each in priors.fit_parameters].index("r1/r2")] = math.log(0.96)
    found = priors.parameters(priors.values(start))
    assert found.r1 / found.r2 == pytest.approx(0.96 * base.r1 / base.r2)
    assert (found.J1, found.J2, found.Mg) == pytest.approx((base.J1, base.J2, base.Mg))
    assert (found.d1, found.M10) == pytest.approx((base.d1, base.M10))


def test_a_release_that_acts_at_once_still_has_a_slope_that_leads_away_from_there():
    priors = Priors(RigParameters.named("mask"), (0.6,), ASSUMED)
    begun = priors.values([each.start for each in priors.fit_parameters])
    later_s = (-0.013, -0.011, -0.01, 0.0, 0.004)
    rigs = [priors.variation(begun | {"release_delay": each}, rolling=False) for each in later_s]
    released_s = [rig.brake_dead_time_s + rig.brake_release_delay_s for rig in rigs]
    assert 0.0 < released_s[0] < released_s[1] < released_s[2] < 0.001
    assert released_s[3:] == pytest.approx([0.01, 0.014], abs=1e-9)


def test_a_dead_time_of_none_still_has_a_slope_that_leads_away_from_there():
    priors = Priors(RigParameters.named("mask"), (0.6,), ASSUMED)
    begun = priors.values([each.start for each in priors.fit_parameters])
    tried_s = (-0.003, -0.001, 0.0, 0.01, 0.05)
    found_s = [priors.variation(begun | {"dead_time": each}, rolling=False).brake_dead_time_s for each in tried_s]
    assert 0.0 < found_s[0] < found_s[1] < found_s[2] < 0.001
    assert found_s[3:] == pytest.approx([0.01, 0.05], abs=1e-9)


def test_the_last_digits_of_a_parameter_move_no_count(sessions):
    """Else the search ends in a dent of the sum of squares, and which one depends on the processor's rounding."""
    priors = Priors(RigParameters.named("mask"), (0.6, 0.7), ASSUMED)
    begun = priors.values([each.start for each in priors.fit_parameters])
    sets = [begun | {"stall": begun["stall"] * (1.0 + i * 1e-10)} for i in range(100)]
    run_ups = [part for part in parts_of(sessions.values()) if part.kind == "run-up"]
    assert run_ups
    for part in run_ups:
        for simulated in angles(part, priors, sets, [(0.0, 0.0)] * len(sets)):
            counts = simulated * part.counts_per_turn / (2.0 * math.pi)
            assert np.ptp(counts, axis=0).max() < 1e-3


@pytest.mark.long
def test_a_friction_curve_of_the_measured_form_is_part_of_the_intervals(found):
    names = [each.name for each in found.fit.priors.fit_parameters]
    blend, ratio = names.index("blend"), names.index("r1/r2")
    assert found.fit.found[blend] == 0.0
    assert found.fit.moved[ratio, blend] > 1e-4  # too small an estimate where the curve is the measured one
    assert found.fit.total[ratio, ratio] > found.fit.moved[ratio, blend] ** 2 / 3.0


def true_values():
    k = RIG.parameters
    share = (k.r2 / k.r1) ** 2
    inertia, d, M0 = k.J2 + share * k.J1, k.d2 + share * k.d1, k.M20 + k.r2 / k.r1 * k.M10
    return {
        **{name: getattr(k, name) for name in ("J1", "J2", "Mg", "d1", "M10", "d2", "M20")},
        "d": d,
        "M0": M0,
        "d/J": d / inertia,
        "M0/J": M0 / inertia,
        "drive_stall_torque": 1.72,
        "drive_no_load_speed": 300.0,
        "r1/r2": k.r1 / k.r2,
        "brake_lag": 1.0 / k.c31,
        "brake_dead_time": RIG.brake_dead_time_s,
        "wheel_eccentricity": RIG.wheel_encoder.eccentricity_counts,
        "wheel_second_harmonic": RIG.wheel_encoder.second_harmonic_counts,
        "road_eccentricity": RIG.road_encoder.eccentricity_counts,
        "road_second_harmonic": RIG.road_encoder.second_harmonic_counts,
        "M1(0.6)": settled_torque(round(0.6 * PWM_STEPS) / PWM_STEPS, RIG),
        "M1(0.7)": settled_torque(round(0.7 * PWM_STEPS) / PWM_STEPS, RIG),
    }


@pytest.mark.parametrize("name", true_values())
def test_the_interval_holds_the_true_number(identified, name):
    estimate, slack = identified[0][name], 1.5  # 95 % is not always
    half = 0.5 * (estimate["high"] - estimate["low"])
    assert true_values()[name] == pytest.approx(estimate["value"], abs=slack * half)


@pytest.mark.parametrize(
    ("name", "share"), [("d/J", 0.01), ("M0/J", 0.005), ("d", 0.1), ("M1(0.6)", 0.1), ("road_eccentricity", 0.4)]
)
def test_the_interval_is_narrow_for_what_counts_determine(identified, name, share):
    estimate = identified[0][name]
    assert estimate["status"] == "identified"
    assert estimate["high"] - estimate["low"] < share * estimate["value"]


def test_what_is_assumed_stays_as_it_is_believed_and_is_called_so(identified):
    assumed = {name for name, each in identified[0].items() if each["status"] == "assumed"}
    assert assumed == {"J1", "J2", "Mg", "d1", "M10"}
    assert identified[0]["J1"]["value"] == pytest.approx(identified[0]["J1"]["published"])


def test_the_parameter_file_is_a_configuration_for_all_that_uses_a_model(identified):
    model = load_config(identified[1]).model
    estimates = identified[0]
    parameters = nominal_parameters(model)
    assert parameters.r1 / parameters.r2 == pytest.approx(estimates["r1/r2"]["value"])
    assert parameters.d2 == pytest.approx(estimates["d2"]["value"])
    assert 1.0 / parameters.c31 == pytest.approx(estimates["brake_lag"]["value"])
    assert nominal_brake_map(model).torque(0.7) == pytest.approx(estimates["M1(0.7)"]["value"])
    assert model.identified.drive_no_load_speed_rad_s == estimates["drive_no_load_speed"]["value"]


def test_the_file_for_a_controller_is_all_that_a_run_needs(found, tmp_path):
    chosen_law = load_config(settings=("controller.name=boundary-layer", "estimator.name=kalman"))
    law = with_identified(chosen_law, found, CONTROLLERS)
    loaded = load_config(found.save(tmp_path / "law.toml", law_sections(law)))
    assert loaded == law
    assert (loaded.controller.name, loaded.estimator.name) == ("boundary-layer", "kalman")
    assert loaded.controller.gains == {"lag_s": pytest.approx(1.0 / loaded.model.identified.c31, abs=1e-4)}
    stated = replace(chosen_law, controller=replace(chosen_law.controller, gains={"lag_s": 0.055}))
    assert with_identified(stated, found, CONTROLLERS).controller.gains == {"lag_s": 0.055}


def test_the_uncertainty_for_design_is_that_of_the_intervals(identified, found):
    stated = dict(statement.split("=") for statement in found.uncertainty(0.2))
    mu, d2 = identified[0]["mu(0.2)"], identified[0]["d2"]
    assert float(stated["mu"]) == pytest.approx(0.5 * (mu["high"] - mu["low"]) / mu["value"], rel=0.01)
    assert float(stated["d2"]) == pytest.approx(0.5 * (d2["high"] - d2["low"]), rel=0.01)
    unknown = [replace(each, status="not identified") if each.name == "d2" else each for each in found.estimates]
    assert replace(found, estimates=tuple(unknown)).uncertainty(0.2) is None


def test_the_file_keeps_the_geometry_and_the_parameter_set_of_the_configuration(found):
    measured = IdentifiedConfig(r2=0.0991, L=0.371, phi_rad=1.14)
    kept = replace(found, model=ModelConfig(parameters="table", identified=measured)).identified_model
    assert kept.parameters == "table"
    assert (kept.identified.r2, kept.identified.L, kept.identified.phi_rad) == (0.0991, 0.371, 1.14)
    assert kept.identified.d2 == found.identified_model.identified.d2


@pytest.mark.long
def test_a_coast_down_alone_leaves_the_brake_unknown_which_is_named(sessions, capsys):
    out = sessions["coast"].with_name("coast.toml")
    assert identify(sessions["coast"], "--json", "-o", out) == 3
    printed = capsys.readouterr()
    missing = {each["name"] for each in json.loads(printed.out)["estimates"] if each["status"] == "not identified"}
    assert {"brake_lag", "brake_dead_time", "mu(0.2)"} <= missing
    assert "d" not in missing
    assert "not identified: brake_lag, brake_dead_time, brake_fade: no session has brake steps" in printed.err
    assert "identify --plan with these sessions records what would help most\n" in printed.err
    assert not {"c31", "w4", "b1"} & tomllib.loads(out.read_text())["model"]["identified"].keys()


@pytest.mark.long
def test_a_better_known_inertia_makes_the_interval_narrower(sessions, capsys):
    def half_width(*arguments):
        identify(sessions["coast"], "--json", *arguments)
        estimates = {each["name"]: each for each in json.loads(capsys.readouterr().out)["estimates"]}
        return estimates["d"]["high"] - estimates["d"]["value"]

    known = half_width("--assume", "J1=1%", "--assume", "J2=1%", "--assume", "Mg=1%")
    assert known == pytest.approx(half_width() / 5.0, rel=0.1)


@pytest.mark.long
def test_the_figure_shows_what_is_left(sessions, tmp_path):
    identify(sessions["coast"], "--figure", tmp_path / "left.png")
    assert (tmp_path / "left.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "name at least one session"),
        (("--dry-run", "a.mcap"), "only with --plan"),
        (("a.mcap", "--assume", "J3=5%"), "not an assumed parameter; known: J1"),
        (("a.mcap", "--assume", "J1=0.05"), "must look like J1=5%"),
        (("a.mcap", "-o", "a.txt"), "must end in .toml"),
        (
            ("a.mcap", "-o", Path(__file__).parents[2] / "pyproject.toml"),
            "exists already, and files are never overwritten",
        ),
        (("--plan", "--controller", "boundary-layer"), "not with --plan"),
        (("a.mcap", "--estimator", "kalman"), "only with --controller"),
        (("a.mcap", "--controller", "own.py:Law"), "a file cannot name it"),
        (("a.mcap", "--controller", "boundary"), "boundary-layer"),
        (("--plan", "--board", "usb2:", "--rig", "hard:1"), "a real board has its own rig"),
    ],
)
def test_wrong_usage_says_what_to_do(arguments, message):
    with pytest.raises(ConfigError, match=message):
        identify(*arguments)


def test_plan_is_recorded_run_by_run_and_ends_with_the_first_stopped_run(tmp_path, capsys):
    late = ("--set", "experiment.spin_up_timeout_s=0.1")
    assert identify("--plan", "--virtual", *late, "-o", tmp_path) == 5
    assert [file.name for file in tmp_path.iterdir()] == ["coast.mcap"]
    assert "coast: fault: the start speed was not reached in time" in capsys.readouterr().err


def half_widths(found):
    return {each.name: 0.5 * (each.high - each.low) for each in found.estimates}


def test_the_next_runs_begin_with_what_the_sessions_do_not_show(found):
    first, *others = next_runs(found, 0.8, 60.0)
    assert first.name == "stair-4"
    assert "M1(0.45) from ±" in first.shows
    assert any("brake_release_delay from ±" in each.shows for each in others)
    assert [each.name.rpartition("-")[2] for each in others] == ["5", "6"]
    assert all(0.0 <= each.first <= 0.8 for each in (first, *others))


@pytest.mark.long
def test_the_next_run_brings_what_it_promises(sessions, found, tmp_path):
    run = next(each for each in next_runs(found, 1.0, 60.0) if "release_delay" in each.shows)
    slower = ("experiment.start_speed_rad_s=60", "simulation.rig=hard:3", *run.settings)
    untraced(run_stop, load_config(settings=slower), Plan(tmp_path / "next.mcap"))
    again = fitted(parts_of([*sessions.values(), tmp_path / "next.mcap"]), ModelConfig())
    promised = float(re.search(r"brake_release_delay from ±[\d.e-]+ to ±([\d.e-]+) s", run.shows)[1])
    assert half_widths(again)["brake_release_delay"] == pytest.approx(promised, rel=0.5)
    assert promised < 0.5 * half_widths(found)["brake_release_delay"]


@pytest.mark.long
def test_the_plan_after_sessions_is_what_is_left_to_record(sessions, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dry = ("--plan", "--virtual", "--dry-run", "--set", "experiment.start_speed_rad_s=60", "-o", "next")
    assert identify(*sessions.values(), *dry) == 0
    assert "stair-4.mcap" in capsys.readouterr().out


@pytest.mark.long
def test_the_whole_plan_is_recorded(tmp_path):
    slow = ("--set", "experiment.start_speed_rad_s=20")
    assert identify("--plan", "--virtual", *slow, "-o", tmp_path) == 0
    assert {file.stem for file in tmp_path.iterdir()} == {each.name for each in experiments(1.0)}


def test_a_measured_geometry_replaces_the_published_one():
    measured = {"r1": 0.0956, "r2": 0.0991, "L": 0.371, "phi_rad": 1.14}
    settings = [f"model.identified.{name}={value}" for name, value in measured.items()]
    parameters = nominal_parameters(load_config(settings=settings).model)
    assert {name: getattr(parameters, name) for name in measured} == measured


def test_a_wrong_configuration_of_the_plan_is_reported_as_json(capsys):
    wrong = ("--set", "guard.brake_limit=7")
    assert identify("--plan", "--virtual", "--dry-run", "--json", *wrong) == 2
    (refused,) = json.loads(capsys.readouterr().out)["refused"]
    assert refused["where"] == "guard.brake_limit"


OTHER = """base = "hard"
[parameters]
r1 = 0.085
r2 = 0.11
L = 0.40
phi_rad = 1.20
"""
MEASURED = {"r1": 0.086, "r2": 0.11, "L": 0.40, "phi_rad": 1.20}


@pytest.mark.long
@pytest.mark.parametrize(("draw", "measured", "share"), [("hard:17", {}, 0.12), ("other.toml:5", MEASURED, 0.45)])
def test_a_law_on_the_identified_model_holds_the_slip_better(tmp_path, monkeypatch, capsys, draw, measured, share):
    """Also on a rig with another geometry, as a ruler measures it: r1 is found to be 1.2 % smaller."""
    monkeypatch.chdir(tmp_path)
    Path("other.toml").write_text(OTHER)
    rig, own = ("--virtual", "--rig", draw), set_model(measured)
    assert identify("--plan", *rig, *own, "-o", "plan") == 0
    capsys.readouterr()
    law = ("--controller", "boundary-layer", "--estimator", "kalman")
    assert identify(*sorted(Path("plan").glob("*.mcap")), *own, *law, "--json", "-o", "rig.toml") == 0

    def slip_rms(name, *given):
        capsys.readouterr()
        run = ("run", *rig, *given, "--quiet", "--json", "--out", name)
        untraced(partial(cli.main, list(run), standalone_mode=False))
        return json.loads(capsys.readouterr().out)["slip_rms_true"]

    assert json.loads(capsys.readouterr().out)["design"]["loop"]
    config = load_config(Path("rig.toml"))
    geometry = {name: getattr(nominal_parameters(config.model), name) for name in measured}
    assert geometry == pytest.approx(measured | {"r1": 0.085} if measured else {}, rel=1e-3)
    lag = f"controller.gains.lag_s={config.controller.gains['lag_s']}"
    identified = slip_rms("identified.mcap", "--config", "rig.toml")
    assert identified < 0.0035
    assert identified < share * slip_rms("published.mcap", *own, *law, "--set", lag)


def test_the_plan_keeps_to_the_guards_limit():
    duties = [float(each.name[-3:]) / 100 for each in experiments(0.7) if each.name.startswith("stop-")]
    assert max(duties) == 0.7


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (("model.identified.brake_duties=[0.5,0.6]",), "each duty needs its torque"),
        (
            ("model.identified.brake_duties=[0.6,0.5]", "model.identified.brake_torques_nm=[1.0,2.0]"),
            "must rise from value to value",
        ),
        (("model.identified.J1=-1.0",), "J1"),
    ],
)
def test_a_parameter_file_that_cannot_be_is_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        load_config(settings=settings)
