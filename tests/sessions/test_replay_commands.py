"""The verbs replay, what-if and golden on the command line."""

import json

import pytest

from inteco_abs.sessions import FileWriter
from inteco_abs.signals import Phase


@pytest.fixture
def command(verb, tmp_path, monkeypatch):
    """Runs the command in an empty folder, in this process; gives exit code, output and messages."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return verb


@pytest.fixture
def rewritten(tmp_path, quick):
    """Path of `quick` with other ticks or another configuration."""

    def write(session=quick.session, config=None):
        path = tmp_path / "rewritten.mcap"
        with FileWriter(path, 0) as recorder:
            recorder.describe("controller", session.metadata["controller"])
            recorder.attach("config.toml", "application/toml", config or session.attachments["config.toml"])
            recorder.begin({})
            recorder.ticks(session.payload)
            recorder.finish("completed", "no fault", quick.stop.card)
        return path

    return write


def test_replay_of_a_run_says_that_all_agrees(command, quick):
    code, printed, _ = command("replay", quick.path, "--json")
    report = json.loads(printed)
    assert code == 0
    assert {"ticks", "differing", "first", "by_field"} <= report.keys()
    assert (report["differing"], report["agreeing_ticks"], report["gains"]) == (0, report["ticks"], {})


def test_replay_with_another_gain_names_it(command, quick, rewritten):
    config = quick.session.attachments["config.toml"].decode()
    path = rewritten(config=config.replace("[controller.gains]", "[controller.gains]\nMk = 2.5").encode())
    code, printed, _ = command("replay", path)
    assert code == 4
    was = "the gain Mk was 0x1.0000000000000p+1 in the run (metadata controller: gain.Mk.hex)"
    assert f"{was} and is 0x1.4000000000000p+1 now" in printed
    assert "torque_demand_nm" in printed


def test_replay_with_another_gain_that_changes_nothing_differs_all_the_same(command, run, rewritten):
    session = run("controller.name=boundary-layer").session
    config = session.attachments["config.toml"].decode()
    path = rewritten(session, config.replace("[controller.gains]", "[controller.gains]\nlag_s = 1e-12").encode())
    code, printed, _ = command("replay", path, "--tol", "*=100", "--json")
    assert code == 4
    assert list(json.loads(printed)["gains"]) == ["lag_s"]


def test_replay_reports_what_comes_early_and_how_long_all_agreed(command, quick, retouched, rewritten):
    session = quick.session
    began = int((session.ticks["phase"] == Phase.BRAKING).argmax())
    path = rewritten(retouched(session, began, phase=int(Phase.SPIN_UP)))
    code, printed, _ = command("replay", path)
    assert code == 4
    assert f"before it {began} ticks agree" in printed
    assert f"phase becomes BRAKING 1 tick early, at tick {began}" in printed
    code, printed, _ = command("replay", path, "--tol", "phase=::0.001")
    assert code == 0
    assert "1 within their tolerance" in printed


def test_replay_with_invalid_tolerances_ends_with_2(command, quick):
    code, _, said = command("replay", quick.path, "--tol", "brke=1", "--tol", "slip")
    assert code == 2
    assert "did you mean brake" in said
    assert "--tol slip: must look like" in said


def test_what_if_sweeps_and_reports_the_horizon(command, quick):
    code, printed, _ = command("what-if", quick.path, "--sweep", "controller.gains.Mk=2,5,20", "--json")
    report = json.loads(printed)
    horizons = [each["horizon_s"] for each in report["alternatives"]]
    assert code == 0
    assert [each["name"] for each in report["alternatives"]] == [f"controller.gains.Mk={k}" for k in (2, 5, 20)]
    assert (horizons[0], horizons[2]) == (None, pytest.approx(0.0005))
    assert "simulation" not in report


def test_what_if_says_in_what_fault_a_simulation_ends(command, quick, tmp_path):
    (tmp_path / "own.py").write_text(
        "from inteco_abs.signals import BrakeDemand\n"
        "class Own:\n"
        "    gains = internals = ()\n"
        "    def __init__(self, _setup): pass\n"
        "    def update(self, _estimate, _dt_s): return BrakeDemand(float('nan'))\n"
    )
    asked = ("what-if", quick.path, "--controller", "own.py:Own", "--closed-loop")
    assert "own.py:Own: ends in the fault BAD_OUTPUT" in command(*asked)[1]
    closed = json.loads(command(*asked, "--json")[1])["alternatives"][0]["closed_loop"]
    assert closed["reason"] == "BAD_OUTPUT"


def test_what_if_says_open_loop_does_not_react_and_closed_loop_simulates(command, quick):
    code, printed, _ = command("what-if", quick.path, "--controller", "relay", "--at", "0.05")
    assert code == 0
    (duty,) = (line.split() for line in printed.splitlines() if "brake duty, 1" in line)
    assert duty[3] == "0.0500"
    assert "the logged counts do not react" in printed
    code, printed, _ = command("what-if", quick.path, "--estimator", "kalman", "--closed-loop")
    assert code == 0
    assert "a SIMULATION of the rig mask" in printed
    assert "leaves the log by: road_speed_rad_s 0, slip 0, brake 0" in printed


def test_what_if_prints_requests_and_log_before_simulated_results(command, quick):
    sweep = ("what-if", quick.path, "--sweep", "controller.gains.Mk=2,20", "--closed-loop")
    requests, _, simulated = command(*sweep)[1].partition("closed loop: a")[0].partition("simulated from there on")
    report = json.loads(command(*sweep, "--json")[1])
    torques = [line.split() for line in requests.splitlines() if "torque, N m" in line]
    assert torques[0][3] == "never"
    for row, each in zip(torques, report["alternatives"], strict=True):
        assert row[4] == f"{each['open_loop'][1]['largest']:.3g}"
    rows = [line.split() for line in simulated.splitlines() if " log " in line or " controller.gains" in line]
    assert [row[0] for row in rows] == ["log", "controller.gains.Mk=2", "controller.gains.Mk=20"]
    assert rows[0][2] == f"{report['simulation']['log']['stop_time_s']:.3g}"


@pytest.mark.long
def test_what_if_draws(command, quick, tmp_path):
    arguments = ("--sweep", "controller.gains.Mk=2,20", "--closed-loop", "--figure", "drawn.svg")
    code, _, said = command("what-if", quick.path, *arguments)
    assert (code, said) == (0, "figure: drawn.svg\n")
    assert (tmp_path / "drawn.svg").read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "nothing to compare"),
        (("--set", "loop.rate_hz=100"), "cannot be changed here"),
        (("--set", "controller.gains.Mk=x"), "controller.gains.Mk: 'x'"),
        (("--controller", "rely"), "did you mean relay"),
        (("--estimator", "kalmn"), "did you mean kalman"),
        (("--sweep", "controller.gains.Mk"), "must look like controller.gains.Mk=1,2,5"),
        (("--sweep", "controller.gains.Mk=1,,2"), "must look like"),
        (("--sweep", f"controller.gains.Mk={','.join(map(str, range(200)))}"), "200 alternatives: must be at most 100"),
        (("--sweep", "controller.gains.Mk=1,2,3,4,5,6,7,8", "--figure", "x.svg"), "a figure shows at most 7"),
        (("--controller", "relay", "--figure", "x.bmp"), "must end in .png"),
        (("--controller", "relay", "--duty", "-1"), "--duty"),
        (("--controller", "relay", "--at", "soon"), "--at"),
    ],
)
def test_what_if_used_wrongly_ends_with_2(command, quick, arguments, words):
    code, printed, said = command("what-if", quick.path, *arguments)
    assert (code, printed) == (2, "")
    assert words in said


def test_what_if_at_a_time_at_which_nothing_ran_ends_with_1(command, quick):
    code, _, said = command("what-if", quick.path, "--controller", "relay", "--closed-loop", "--at", "99")
    assert code == 1
    assert "choose a time in" in said


def test_golden_adds_tests_and_lists(command, quick):
    assert command("golden", "add", quick.path, "--name", "one", "--reason", "why not")[0] == 0
    code, printed, _ = command("golden", "test")
    assert (code, printed) == (0, f"one: {quick.stop.card['ticks']} ticks replayed, none differ\n")
    code, printed, _ = command("golden", "list")
    assert code == 0
    assert "why not" in printed
    (listed,) = json.loads(command("golden", "list", "--json")[1])["sessions"]
    assert (listed["name"], listed["tolerances"]) == ("one", [])
    assert command("golden", "add", quick.path, "--name", "one", "--reason", "again")[0] == 2
    assert command("golden", "update", "one", "--reason", "nothing changed")[0] == 2


def test_golden_ends_with_4_and_names_the_first_difference(command, quick, monkeypatch):
    assert command("golden", "add", quick.path, "--name", "one", "--reason", "why not")[0] == 0
    monkeypatch.setattr("inteco_abs.control.controllers.reaching.ReachingLaw._rate", lambda *_: 1.0)
    code, printed, _ = command("golden", "test", "one")
    assert code == 4
    assert "first at tick" in printed
    assert "torque_demand_nm was" in printed
    assert json.loads(command("golden", "test", "--json")[1])["differing"] == ["one"]
    assert command("golden", "update", "one", "--reason", "a constant law")[0] == 0
    assert command("golden", "test")[0] == 0


def test_golden_ends_with_1_where_a_session_cannot_be_tested(command, quick, tmp_path):
    assert command("golden", "add", quick.path, "--name", "one", "--reason", "why not", "--json")[0] == 0
    (tmp_path / "golden" / "one.mcap").unlink()
    code, printed, _ = command("golden", "test")
    assert code == 1
    assert "one: cannot be tested" in printed


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("golden", "test"), 2, "has no golden session"),
        (("golden", "list"), 2, "has no golden session"),
        (("golden", "add", "none.mcap", "--reason", "x"), 1, "none.mcap: cannot be read"),
        (("golden", "add", "none.mcap"), 2, "--reason"),
        (("golden", "update", "one"), 2, "--reason"),
        (("what-if", "none.mcap", "--controller", "relay"), 1, "none.mcap: cannot be read"),
    ],
)
def test_what_is_not_there_is_reported(command, arguments, code, words):
    ended, _, said = command(*arguments)
    assert ended == code
    assert words in said


@pytest.mark.parametrize("number", ["nan", "inf", "-inf"])
@pytest.mark.parametrize(
    "arguments",
    [
        ("what-if", "none.mcap", "--at"),
        ("what-if", "none.mcap", "--duty"),
        ("what-if", "none.mcap", "--torque"),
        ("golden", "add", "none.mcap", "--reason", "why not", "--until"),
        ("diff", "none.mcap", "none.mcap", "--rel"),
    ],
    ids=lambda arguments: arguments[-1],
)
def test_what_is_not_a_number_is_wrong_usage(command, arguments, number):
    ended, _, said = command(*arguments, number)
    assert ended == 2
    assert f"Invalid value for '{arguments[-1]}'" in said


@pytest.mark.parametrize(
    "words", [("replay",), ("what-if",), ("golden", "add"), ("golden", "test"), ("golden", "update")]
)
def test_help_lists_the_exit_codes(command, words):
    code, printed, _ = command(*words, "--help")
    assert code == 0
    assert "Exit codes: 0 " in " ".join(printed.split())
