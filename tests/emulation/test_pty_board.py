"""The mock RT-DAC/USB as a serial port, and the whole command driving it: real pyserial on a real terminal."""

import json
import os
import re
import signal
import subprocess
import sysconfig
import time
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from live import LiveRun

from inteco_abs.commissioning import STEPS, ProfileDraft
from inteco_abs.realtime.memory import Field

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"
UNTRACED = {key: value for key, value in os.environ.items() if not key.startswith("COV")}
RATES_HZ = (250, 250, 120, 80, 60)
"""The real board's first; a busy computer may not keep it, and a run that has not begun may be tried again."""
BUSY = ("set loop.rate_hz to", "within 10 ms", "exchanges with the board failed")
"""Message of a run in that case."""
PAUSED = ("late, slow or failed", "hung and was killed")
"""What it says when the computer has paused for longer than a real board's limits allow."""
REAL_LIMITS = ("profile=sim_usb", "guard.missed_in_a_row=6", "guard.bucket_limit=36", "guard.silence_s=0.05")
"""Those that a real board's profile has, not the mock's own."""
PHRASE = "the cover is closed, my hand is at the emergency switch"
TRIP_TICKS = 30
"""A few ticks after the start: the drive is on."""


class Mock:
    """`inteco-abs mock-board --pty`, and its standard output."""

    def __init__(self, folder, *arguments):
        self.port, self._truth = folder / "board", folder / "truth.jsonl"
        self.process = subprocess.Popen(
            [COMMAND, "mock-board", "--pty", self.port, "--truth", self._truth, *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**UNTRACED, "PYTHONUNBUFFERED": "1"},
        )  # fmt: skip
        self.printed = [self.process.stdout.readline() for _ in range(2)]

    def truth(self):
        """The newest line."""
        lines = self._truth.read_text().rpartition("\n")[0].splitlines() if self._truth.exists() else []
        return json.loads(lines[-1]) if lines else {}

    def until(self, condition):
        end = time.monotonic() + 30.0
        while not condition(self.truth()):
            assert time.monotonic() < end, self.truth()
            time.sleep(0.02)

    def lines(self):
        return [json.loads(line) for line in self._truth.read_text().splitlines()]

    def end(self):
        self.process.send_signal(signal.SIGINT)
        _, stderr = self.process.communicate(timeout=10)
        return self.process.returncode, stderr


@pytest.fixture
def mock(tmp_path):
    mock = Mock(tmp_path)
    yield mock
    mock.process.kill()
    mock.process.communicate()


@contextmanager
def live_runs(folder, address, *fixed, rates_hz):
    """What starts a stop at the board and gives it once its loop may go."""
    runs = []

    def start(*settings, rates_hz=rates_hz):
        for rate_hz in rates_hz:
            chosen = (*fixed, f"loop.rate_hz={rate_hz}", *settings)
            run = LiveRun(COMMAND, folder, UNTRACED, "--board", address, settings=chosen, begun=False)
            runs.append(run)
            if begins(run):
                return run
        raise AssertionError("the computer is too busy for any rate")

    yield start
    for run in runs:
        run.destroy()


@pytest.fixture
def live(mock, tmp_path):
    fixed = (*REAL_LIMITS, "experiment.start_speed_rad_s=60")
    with live_runs(tmp_path, f"usb:{mock.port}", *fixed, rates_hz=RATES_HZ) as start:
        yield start


def begins(run):
    """Whether the loop may go; if not, because this computer is too busy for the rate."""
    try:
        run.until(lambda: run.words[Field.GO])
    except AssertionError as error:
        if any(word in str(error) for word in BUSY):
            return False
        raise
    return True


def test_it_says_where_it_is_and_takes_its_link_away_at_control_c(mock):
    assert mock.printed[0] == f"mock RT-DAC/USB at {mock.port}; Ctrl-C unplugs it\n"
    assert f"run --board usb:{mock.port} --set profile=sim_usb" in mock.printed[1]
    assert mock.port.is_symlink()
    code, stderr = mock.end()
    assert code == 0, stderr
    assert not mock.port.is_symlink()


def test_without_a_link_it_names_its_terminal():
    process = subprocess.Popen(
        [COMMAND, "mock-board", "--pty", "--truth", "-", "--truth-hz", "200"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**UNTRACED, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    name = re.match(r"mock RT-DAC/USB at (/dev/pts/\d+);", process.stderr.readline())[1]
    assert Path(name).is_char_device()
    times = [json.loads(process.stdout.readline())["time_ns"] for _ in range(5)]
    assert all(later - earlier >= 5_000_000 for earlier, later in pairwise(times))
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=10)
    assert process.returncode == 0, stderr


@pytest.mark.long
def test_a_whole_stop_in_real_time_over_the_port_replays_without_a_difference(live, mock):
    for at in range(len(RATES_HZ)):
        run = live(rates_hz=RATES_HZ[at:])
        code, card, stderr = run.end()
        if not any(words in stderr for words in PAUSED):
            break
        run.out.unlink()
    assert code in (0, 3), stderr  # a shared computer may be late: that is said, not hidden
    assert card["outcome"] == "completed"
    assert 0.1 < card["stop_time_s"] < 2.0
    mock.until(lambda truth: truth["drive"] == truth["brake"] == 0.0)
    seen = mock.lines()
    assert 30.0 < max(line["road_speed_rad_s"] for line in seen) < 70.0
    assert 1.0 in {line["drive"] for line in seen}
    assert max(line["brake_torque_nm"] for line in seen) > 3.0
    replayed = subprocess.run(
        [COMMAND, "replay", run.out, "--json"], env=UNTRACED, capture_output=True, text=True, check=True
    )
    assert json.loads(replayed.stdout)["differing"] == 0
    assert run.session().ticks["tick"][0] == 0
    validated = subprocess.run(
        [COMMAND, "validate", run.out], env=UNTRACED, capture_output=True, text=True, check=False
    )
    assert validated.returncode == 0, validated.stdout


@pytest.mark.long
def test_guardian_makes_the_board_safe_on_the_port_of_a_killed_loop(live, mock):
    run = live()
    run.until_tick(TRIP_TICKS)
    mock.until(lambda truth: truth["drive"] > 0.0)
    run.kill("loop")
    code, card, stderr = run.end()
    assert (code, card["outcome"]) == (5, "aborted"), stderr
    assert "the guardian made its board safe" in stderr
    mock.until(lambda truth: truth["drive"] == truth["brake"] == 0.0)


@pytest.mark.long
def test_a_board_that_is_unplugged_in_a_run_is_said_loudly(live, mock):
    run = live()
    run.until_tick(TRIP_TICKS)
    mock.until(lambda truth: truth["drive"] > 0.0)
    mock.process.kill()
    code, card, stderr = run.end()
    assert (code, card["outcome"], card["reason"]) == (5, "aborted", "MISSED_EXCHANGES"), stderr
    assert "the board is gone: check cable and power" in stderr
    assert "MOTOR POWER MAY STILL BE ON: press the emergency switch" in stderr


@pytest.mark.long
def test_a_missing_board_is_an_error_before_any_process_starts(tmp_path):
    process = subprocess.run(
        [COMMAND, "run", "--board", f"usb:{tmp_path}/nowhere", "--set", "profile=sim_usb"],
        cwd=tmp_path, env=UNTRACED, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert process.returncode == 1
    assert "nowhere cannot be opened: there is no such port" in process.stderr
    assert "MOTOR POWER" not in process.stderr
    assert not list((tmp_path / "sessions").glob("*"))


@pytest.mark.long
def test_a_mock_made_from_a_report_gives_the_same_report(tmp_path, mock):
    def report(port, name):
        words = "--yes-read-only", "--draft", f"{name}.toml", "--send-report", f"{name}.jsonl"
        subprocess.run(  # a busy computer may be too slow for any rate, and there is a report all the same
            [COMMAND, "commission", "--board", f"usb:{port}", *words],
            cwd=tmp_path, env=UNTRACED, capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        return tmp_path / f"{name}.jsonl"

    first = report(mock.port, "first")
    text = first.read_text()
    name = b"MISBA".hex()  # text runs backwards in a frame
    assert name in text
    seen = tmp_path / "seen.jsonl"
    seen.write_text(text.replace(name, b"REHTO".hex()))
    folder = tmp_path / "of the report"
    folder.mkdir()
    second = Mock(folder, "--from-report", seen)
    try:
        again = report(second.port, "again")
    finally:
        second.process.kill()
        second.process.communicate()
    assert again.read_text().splitlines()[1:] == seen.read_text().splitlines()[1:]


@pytest.fixture
def commissioning(mock, tmp_path):
    """Starts the commissioning at the step that turns the motors, on the mock's port; the steps before are done."""
    started = []

    def start(*lines):
        draft = ProfileDraft.open(tmp_path / "draft.toml", f"usb:{mock.port}", "sim_usb")
        found = {"logic_version": "0x0111"}
        for step in STEPS[:5]:
            draft.record(step.name, {"outcome": "done", "rests_on": draft.wiring(step.rests_on), **found})
        process = subprocess.Popen(
            [COMMAND, "commission", "--board", f"usb:{mock.port}", "--draft", draft.file, "--step", "motors"],
            cwd=tmp_path, env=UNTRACED, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        started.append(process)
        process.stdin.write("".join(f"{line}\n" for line in lines))
        process.stdin.flush()
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_a_commissioning_that_is_killed_with_a_motor_on_leaves_the_outputs_off(commissioning, mock):
    process = driving(commissioning, mock)
    process.kill()
    mock.until(lambda truth: truth["drive"] == truth["brake"] == 0.0)


ENDS = {
    "its own": (lambda _process: None, 1, "a wheel moved although the emergency switch is pressed"),
    "Ctrl-C": (lambda process: process.send_signal(signal.SIGINT), 130, "confirmed that both outputs are off"),
    "the death of the process that holds the board": (
        lambda process: os.kill(holder(process.pid), signal.SIGKILL),
        1,
        "the process that held the board died; the guardian has written SAFE and read it back",
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("how", ENDS)
def test_commissioning_that_ends_with_a_motor_on_says_how_and_switches_it_off(commissioning, mock, how):
    end, code, expected = ENDS[how]
    for _ in RATES_HZ:
        process = driving(commissioning, mock)
        end(process)
        _, stderr = process.communicate(timeout=30)
        if not any(words in stderr for words in PAUSED):
            break
    assert (process.returncode, expected in stderr) == (code, True), stderr
    mock.until(lambda truth: truth["drive"] == truth["brake"] == 0.0)


def driving(commissioning, mock):
    """A commissioning with a motor on; a busy computer, on which the board could not be opened, is tried again."""
    for _ in RATES_HZ:
        process = commissioning("", PHRASE, "yes", "")
        while process.poll() is None:
            if mock.truth().get("drive", 0.0) > 0.0:
                return process
            time.sleep(0.01)
        stderr = process.stderr.read()
        assert any(word in stderr for word in BUSY), stderr
    raise AssertionError("the computer is too busy to open the board")


def holder(pid):
    """Process that holds the board for the commissioning in the process `pid`."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    (found,) = [one for one in children if b"manual" in Path(f"/proc/{one}/cmdline").read_bytes().split(b"\0")]
    return int(found)
