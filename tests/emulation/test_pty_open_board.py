"""The mock open board as a serial port: whole stops by the installed command, and every process of a run killed."""

import json
import os
import signal
import subprocess
import time
from contextlib import suppress

import pytest
from test_pty_board import BUSY, COMMAND, PAUSED, UNTRACED, Mock, live_runs

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced, pytest.mark.long]

RATES_HZ = (250, 250, 125, 100)
"""Rates of the board's tick; a busy computer may not keep the first."""
WATCHDOG_MS = 60
SETTINGS = (
    "profile=sim_open", "experiment.start_speed_rad_s=60", "guard.missed_in_a_row=10", "guard.bucket_limit=60",
    "estimator.window_s=0.03", f"board.watchdog_ms={WATCHDOG_MS}",
)  # fmt: skip
REPORTED_MS = 15
"""The mock notes its state every 5 ms, and a shared computer pauses."""


@pytest.fixture
def mock(tmp_path):
    mock = Mock(tmp_path, "--board", "open", "--truth-hz", "200")
    yield mock
    mock.process.kill()
    mock.process.communicate()


@pytest.fixture(params=["computer", "board"])
def live(request, mock, tmp_path):
    fixed = (*SETTINGS, f'loop.pace="{request.param}"')
    with live_runs(tmp_path, f"open:{mock.port}", *fixed, rates_hz=RATES_HZ) as start:
        yield start


def test_a_whole_stop_replays_without_a_difference(live, mock):
    for _ in RATES_HZ:
        run = live()
        code, card, stderr = run.end()
        if not any(words in stderr for words in (*PAUSED, *BUSY)):
            break
        run.out.unlink()
    assert code in (0, 3), stderr
    assert card["outcome"] == "completed"
    mock.until(lambda truth: truth["drive"] == truth["brake"] == 0.0)
    replayed = subprocess.run(
        [COMMAND, "replay", run.out, "--json"], env=UNTRACED, capture_output=True, text=True, check=True
    )
    assert json.loads(replayed.stdout)["differing"] == 0


def test_with_every_process_killed_the_board_lets_go(live, mock):
    run = live()
    run.until_tick(40)
    mock.until(lambda truth: truth["drive"] > 0.0)
    for pid in run.processes():
        os.kill(pid, signal.SIGSTOP)  # none acts for another before its end
    killed_ns = time.monotonic_ns()
    for pid in [*run.processes(), run.process.pid]:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    mock.until(lambda truth: truth["drive"] == truth["brake"] == 0.0)
    on = [line["time_ns"] for line in mock.lines() if line["drive"] or line["brake"]]
    assert (on[-1] - killed_ns) * 1e-6 <= WATCHDOG_MS + REPORTED_MS
    time.sleep(0.2)
    assert mock.truth()["drive"] == mock.truth()["brake"] == 0.0
