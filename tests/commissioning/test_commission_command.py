"""The verb on the command line, driven by lines on stdin."""

import json
import os
import signal
import subprocess
import sys
import sysconfig
import time
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import pytest

from inteco_abs.cli import main
from inteco_abs.config import load_config

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"
PATIENCE_S = 30.0


class Done(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def installed(tmp_path):
    """Runs the installed command in an empty folder with these lines on its stdin."""

    def run(*arguments, lines=(), verb="commission"):
        process = subprocess.run(
            [COMMAND, verb, *arguments],
            cwd=tmp_path,
            input="".join(f"{line}\n" for line in lines),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert "Traceback" not in process.stderr
        return process

    return run


@pytest.fixture
def commission(tmp_path, monkeypatch, capsys):
    """Runs the command's main() in this process, in the same way: a tenth of what starting it costs."""

    def run(*arguments, lines=(), verb="commission"):
        monkeypatch.setattr(sys, "argv", ["inteco-abs", verb, *arguments])
        monkeypatch.setattr(sys, "stdin", StringIO("".join(f"{line}\n" for line in lines)))
        monkeypatch.chdir(tmp_path)
        with pytest.raises(SystemExit) as end:
            main()
        done = Done(end.value.code or 0, *capsys.readouterr())
        assert "Traceback" not in done.stderr
        return done

    return run


def test_all_commissioning_steps_then_a_stop_with_the_signed_draft(installed, whole_script):
    procedure = installed("--board", "sim:", "--virtual", "--draft", "lab.toml", "--json", lines=whole_script)
    assert procedure.returncode == 0, procedure.stderr
    report = json.loads(procedure.stdout)
    assert report["next"] is None
    assert report["verified_by"] == "the lab"
    assert [one["outcome"] for one in report["steps"]] == ["done"] * 7
    quick = ("--set", "profile=lab.toml", "--set", "experiment.start_speed_rad_s=60")
    stop = installed("--board", "sim:", *quick, "--virtual", "--out", "stop.mcap", "--json", verb="run")
    assert stop.returncode == 0, stop.stderr
    assert json.loads(stop.stdout)["outcome"] == "completed"


@pytest.mark.long
def test_an_odd_rig_is_commissioned_and_stopped(commission, scripts, odd):
    settings = [part for one in (*odd, "board.drive_pwm=1", "board.brake_pwm=0") for part in ("--set", one)]
    lines = [*[""] * 3, *["", "", "yes", "10", "", "10"], *scripts["echo"], *scripts["motors"], *scripts["sign"]]
    procedure = commission("--virtual", "--draft", "odd.toml", *settings, lines=lines)
    assert procedure.returncode == 0, procedure.stderr
    stop = commission("--set", "profile=odd.toml", "--virtual", "--out", "stop.mcap", "--json", verb="run")
    assert stop.returncode == 0, stop.stderr
    card = json.loads(stop.stdout)
    assert card["outcome"] == "completed"
    assert card["slip_rms_fixed_true"] < 0.1


def test_a_profile_that_is_wrong_about_the_mock_does_not_stop_it(commission):
    run = commission("--set", "simulation.road_encoder=5", "--virtual", "--out", "stop.mcap", "--json", verb="run")
    assert run.returncode == 5
    assert json.loads(run.stdout)["reason"] != "NONE"


def test_an_unsigned_draft_does_not_run(commission):
    assert commission("--virtual", "--yes-read-only", "--draft", "lab.toml").returncode == 0
    run = commission("--set", "profile=lab.toml", "--virtual", "--out", "stop.mcap", verb="run")
    assert run.returncode == 1
    assert "reading only" in run.stderr


@pytest.mark.long
def test_reading_steps_need_no_answers_and_the_rest_follows_later(commission, whole_script):
    first = commission("--virtual", "--yes-read-only", "--json")
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["next"] == "wheels"
    second = commission("--virtual", "--json", lines=whole_script[3:])
    assert second.returncode == 0, second.stderr
    assert json.loads(second.stdout)["next"] is None


def test_the_end_of_the_input_is_an_interruption(commission, tmp_path):
    run = commission("--virtual", "--json", lines=["", ""])
    assert run.returncode == 130
    assert json.loads(run.stdout)["next"] == "reads"
    assert load_config(profile=str(tmp_path / "rig-profile.toml")).board.application_names == ["ABSSIM"]


def test_stop_leaves_with_130(commission):
    run = commission("--virtual", lines=["stop"])
    assert run.returncode == 130
    assert "stopped by the operator" in run.stderr


def test_a_wrong_phrase_fails_with_what_to_do(commission):
    lines = [*[""] * 6, "", "it is off"]
    run = commission("--virtual", "--json", lines=lines)
    assert run.returncode == 1
    assert "nothing was written to the board" in run.stderr
    assert json.loads(run.stdout)["steps"][4]["outcome"] == "failed"


@pytest.mark.long
def test_a_step_is_done_again_on_demand(commission, whole_script):
    commission("--virtual", lines=whole_script)
    run = commission("--virtual", "--redo", "4", lines=["", "", ""])
    assert run.returncode == 0, run.stderr
    assert "4 wheels: done" in run.stderr


@pytest.mark.long
@pytest.mark.untraced
@pytest.mark.xdist_group("real time")
def test_in_real_time_a_guarded_process_holds_the_mock(lab, installed, scripts):
    lab.done_until("echo")
    phrase, *rest = scripts["motors"][1:]
    for step, lines in (("echo", scripts["echo"]), ("motors", ["", phrase, "yes", *rest])):  # each is a new mock
        run = installed("--draft", "lab.toml", "--step", step, lines=lines)
        assert run.returncode == 0, run.stderr
        assert "the guardian is drilled first" in run.stderr
    lab.session()
    assert lab.draft.results["motors"]["brake_from"] == pytest.approx(0.415, abs=0.05)


def test_a_real_board_that_is_not_there_fails_the_first_step(commission):
    run = commission("--board", "pci:", "--yes-read-only")
    assert run.returncode == 1
    assert "plug the board in" in run.stderr


def test_ctrl_c_while_a_question_is_open(tmp_path):
    process = subprocess.Popen(
        [COMMAND, "commission", "--virtual"],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        process.stdin.write("\n")
        process.stdin.flush()
        while "logic_version" not in (line := process.stderr.readline()) and line:
            pass
        time.sleep(0.2)
        os.kill(process.pid, signal.SIGINT)
        try:
            process.wait(PATIENCE_S)
        finally:
            process.kill()
        rest = process.stderr.read()
    assert process.returncode == 130
    assert "Traceback" not in rest
    assert (tmp_path / "rig-profile.toml").exists()
