"""`run --inject`: the mock board fails as requested, the run ends as it should, and the session records the faults."""

import json
import time

import pytest

from inteco_abs.sessions import read_session
from inteco_abs.views.report.warnings import warnings_of

QUICK = ("-q", "--set", "experiment.start_speed_rad_s=20")


@pytest.mark.parametrize(
    ("fault", "code", "words"),
    [
        ("lose@brake+20ms", 3, "1 exchanges failed"),
        ("road-stuck@drive+400ms", 5, "the road wheel's encoder loses counts"),
        ("unplug@drive+200ms", 5, "MOTOR POWER MAY STILL BE ON"),
        ("reset=held@drive+400ms", 5, "an encoder count changed faster than any wheel can turn"),
        ("sleep=500@drive+400ms", 5, "an encoder count changed faster than any wheel can turn"),
        ("file-gone@drive+100ms", 3, "is gone"),
    ],
)
def test_a_fault_ends_a_virtual_run_as_it_should_and_is_in_the_session(main_here, tmp_path, fault, code, words):
    stop = main_here("run", "--virtual", *QUICK, "--inject", fault, "--out", "stop.mcap", check=code)
    assert words in stop.stderr
    session = read_session(tmp_path / "stop.mcap")
    [(name, times)] = session.metadata["injected"].items()
    assert name.startswith(fault)
    assert int(times) >= 1
    assert code == 5 or f"injected {name}: acted {times} times" in stop.stderr


def test_session_and_injected_faults_are_reported_where_safe_was_not_confirmed(main_here):
    stop = main_here("run", "--virtual", *QUICK[1:], "--inject", "unplug@drive+200ms", "--out", "stop.mcap", check=5)
    assert stop.stderr.startswith("inteco-abs: SAFE could not be confirmed")
    assert "press the emergency switch" in stop.stderr.splitlines()[0]
    assert "injected unplug@drive+200ms: acted" in stop.stderr
    assert "ABORTED" in stop.stdout
    assert "stop.mcap" in stop.stdout


def test_where_safe_was_not_confirmed_there_is_a_card_as_json_too(main_here, tmp_path):
    options = ("--inject", "unplug@drive+200ms", "--out", "stop.mcap", "--json", "--quiet")
    stop = main_here("run", "--virtual", *QUICK, *options, check=5)
    card = json.loads(stop.stdout)
    assert (card["outcome"], card["session"]) == ("aborted", "stop.mcap")
    assert card["ticks"] == len(read_session(tmp_path / "stop.mcap").ticks)
    assert "press the emergency switch" in card["explanation"]
    assert stop.stderr.startswith("inteco-abs: SAFE could not be confirmed")


def test_before_the_first_tick_it_is_an_error_and_no_file(main_here, tmp_path):
    stop = main_here("run", "--virtual", *QUICK, "--inject", "lose-command@start/600s", "--out", "stop.mcap", check=5)
    assert "press the emergency switch" in stop.stderr
    assert not (tmp_path / "stop.mcap").exists()


def test_info_shows_what_was_injected(main_here):
    main_here("run", "--virtual", *QUICK, "--inject", "lose@brake+20ms", "--out", "stop.mcap", check=3)
    assert "lose@brake+20ms/#1 acted 1 times" in main_here("info", "stop.mcap", check=0).stdout


def test_list_and_report_show_what_was_injected(main_here, tmp_path):
    main_here("run", "--virtual", *QUICK, "--inject", "lose@brake+20ms", "--out", "stop.mcap", check=3)
    (row,) = json.loads(main_here("list", ".", "--json", check=0).stdout)["sessions"]
    assert (row["injected"], row["problem"]) == ("lose@brake+20ms/#1", None)
    assert "injected: lose@brake+20ms/#1" in main_here("list", ".", check=0).stdout
    (caution, *_) = warnings_of(read_session(tmp_path / "stop.mcap"))
    assert caution == "Faults injected into the mock board: lose@brake+20ms/#1 (acted 1 times)."


def test_a_fault_that_never_acts_is_reported(main_here):
    stop = main_here("run", "--virtual", *QUICK, "--inject", "lose@100s", check=0)
    assert "never acted: was the run over before?" in stop.stderr


def test_a_real_board_accepts_no_fault(main_here, tmp_path):
    stop = main_here("run", "--board", "usb2:", "--inject", "lose@1s", check=2)
    assert "faults can be injected into sim: only" in stop.stderr
    assert list(tmp_path.iterdir()) == []


def test_when_nothing_accepts_the_run_the_seed_that_repeats_it_is_reported(main_here, tmp_path):
    stop = main_here("run", "--virtual", *QUICK, "--inject", "disk-full@brake", "--out", "stop.mcap")
    assert stop.returncode != 0
    assert "The run is lost; --seed 0 gives the same again once stop.mcap, if it is there, is removed" in stop.stderr
    whole = main_here("run", "--virtual", *QUICK, "--out", "whole.mcap", check=0)
    assert len(read_session(tmp_path / "whole.mcap").ticks) > 0, whole.stderr


def test_virtual_time_has_no_process_to_kill(main_here, tmp_path):
    stop = main_here("run", "--virtual", "--inject", "loop-killed@1s", "--inject", "guardian-frozen@1s", check=2)
    assert stop.stderr.count("omit --virtual") == 2
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "step_s", [3600, *(pytest.param(each, marks=pytest.mark.long) for each in (-3600, 1, -1000000000))]
)
def test_a_wall_clock_that_steps_changes_no_tick(main_here, tmp_path, step_s):
    seed = ("--virtual", *QUICK, "--seed", "1")
    before_ns = time.time_ns()
    main_here("run", *seed, "--inject", f"clock-step={step_s}@brake", "--out", "stepped.mcap", check=0)
    main_here("run", *seed, "--out", "even.mcap", check=0)
    stepped, even = read_session(tmp_path / "stepped.mcap"), read_session(tmp_path / "even.mcap")
    assert list(stepped.metadata["injected"].values()) == ["1"]
    assert bytes(stepped.payload) == bytes(even.payload)
    assert abs(time.time_ns() - before_ns) < 600e9, "the wall clock was not set back"


def test_the_real_clock_is_not_set(main_here, tmp_path):
    stop = main_here("run", *QUICK, "--inject", "clock-step=1@brake", check=2)
    assert "clock-step: the computer's real clock is not changed; add --virtual" in stop.stderr
    assert list(tmp_path.iterdir()) == []


PCI = ("--set", "profile=sim_pci")


@pytest.mark.parametrize("way", [(), ("--virtual",), ("--dry-run",), ("--virtual", "--dry-run")], ids=" ".join)
@pytest.mark.parametrize(
    ("board", "fault", "said"),
    [
        (PCI, "identity@1s", "identity: no answer of such a board identifies it"),
        (PCI, "alarm=2@1s", "alarm: a run does not read such flags; inteco-abs panel --inject shows them"),
        ((), "alarm=2@1s", "alarm: a run does not read such flags"),
    ],
)
def test_what_this_board_or_a_run_cannot_show_is_refused_however_it_is_requested(
    main_here, tmp_path, board, fault, said, way
):
    refused = main_here("run", *QUICK, *board, *way, "--inject", fault, "--out", "stop.mcap", check=2)
    assert said in " ".join((refused.stdout + refused.stderr).split())
    assert "Traceback" not in refused.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--inject", "alarm=2@1s"), "only of a PCI board: --set profile=sim_pci"),
        (("--inject", "loop-killed@1s"), "loop-killed: the panel records nothing; use inteco-abs run --inject"),
        (("--inject", "disk-full@1s", *PCI), "disk-full: the panel records nothing"),
        (("--inject", "alarm=9@1s", *PCI), "alarm takes a whole number in 1..7 bits"),
        (("--inject", "lose@1s", "--board", "usb2:"), "usb2: is a real board; faults can be injected into sim: only"),
    ],
)
def test_faults_that_do_not_fit_the_panel_are_refused(main_here, arguments, said):
    refused = main_here("panel", "--outputs", "--dry-run", *arguments, check=2)
    assert said in " ".join((refused.stdout + refused.stderr).split())


def test_all_faults_that_cannot_be_injected_are_reported_together(main_here):
    stop = main_here("run", "--virtual", "--inject", "loose@1s", "--inject", "late@1s", check=2)
    assert "did you mean lose?" in stop.stderr
    assert "late needs a value" in stop.stderr


def test_the_kinds_are_listed(main_here):
    listed = main_here("faults", check=0).stdout
    assert "road-stuck" in listed
    assert "reset[=zero|held|random]" in listed


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_a_run_in_real_time_acts_and_reports_its_faults(inteco_abs, untraced, tmp_path):
    stop = inteco_abs(
        "run", *QUICK, "--inject", "lose@brake+20ms/#3", "--inject", "pause=20@drive+300ms", "--out", "stop.mcap",
        environment=untraced,
    )  # fmt: skip
    assert stop.returncode == 3, stop.stderr
    shown = read_session(tmp_path / "stop.mcap").metadata["injected"]
    assert shown["lose@brake+20ms/#3"] == "3"
    assert shown["pause=20@drive+300ms/#1"] == "1"
    assert "injected lose@brake+20ms/#3: acted 3 times" in stop.stderr


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_a_cable_that_is_pulled_in_real_time_is_reported_at_once(inteco_abs, untraced):
    stop = inteco_abs("run", *QUICK, "--inject", "unplug@drive+300ms", environment=untraced)
    assert stop.returncode == 5, stop.stderr
    assert "MOTOR POWER MAY STILL BE ON" in stop.stderr


@pytest.mark.xdist_group("real time")
@pytest.mark.parametrize(
    ("fault", "codes", "words"),
    [
        pytest.param("loop-frozen@drive+300ms", {5}, "the guardian made its board safe", marks=pytest.mark.long),
        pytest.param("disk-full@drive+300ms/200ms", {3}, "cannot be written: File too large", marks=pytest.mark.long),
        pytest.param("loop-killed@brake+20ms", {5}, "the guardian made its board safe", marks=pytest.mark.long),
        pytest.param("guardian-killed@drive+300ms", {5}, "guardian", marks=pytest.mark.long),
        pytest.param("guardian-frozen@drive+300ms/1000ms", {5}, "guardian", marks=pytest.mark.long),
        pytest.param("recorder-killed@drive+300ms", {5}, "recorder", marks=pytest.mark.long),
        pytest.param("recorder-frozen@drive+300ms/300ms", {0, 3}, "", marks=pytest.mark.long),
        pytest.param(
            "supervisor-frozen@drive+#0/2000ms",
            {5},
            "could not have stopped the run",
            marks=pytest.mark.long,
        ),
        pytest.param("supervisor-frozen@drive+300ms", {5}, "could not have stopped the run", marks=pytest.mark.long),
        pytest.param("file-gone@drive+300ms", {3}, "is gone", marks=pytest.mark.long),
    ],
)
def test_a_computer_that_fails_in_real_time_ends_the_run_as_it_should(
    inteco_abs, untraced, tmp_path, fault, codes, words
):
    stop = inteco_abs("run", *QUICK, "--inject", fault, "--out", "stop.mcap", environment=untraced)
    assert stop.returncode in codes, stop.stderr
    assert words in stop.stderr
    [(name, times)] = read_session(tmp_path / "stop.mcap").metadata["injected"].items()
    assert name.startswith(fault)
    assert times == "1"
