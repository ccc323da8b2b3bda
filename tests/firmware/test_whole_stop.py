"""The installed command and the driver on the firmware in its emulators, on both logics."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from emulated import emulated_board, punctual

from inteco_abs.boards import open_board
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError
from inteco_abs.signals import Command

pytestmark = [pytest.mark.long, pytest.mark.untraced, pytest.mark.xdist_group("real time")]

COMMAND = Path(sys.executable).with_name("inteco-abs")
PROBLEMS = 3
"""Exit code of a run that has ended as it should, although a busy computer has missed periods or answers."""
SLOWER = ("loop.rate_hz=100", "estimator.window_s=0.03", "guard.missed_in_a_row=10", "guard.bucket_limit=150")
"""A rate that an emulator keeps up with on a computer that does something else as well."""
LOGICS = {
    "vendor's logic": ("usb", ("profile=sim_usb", *SLOWER)),
    "open logic": ("open", ("profile=sim_open", *SLOWER)),
    "open logic, paced by the board": ("open", ("profile=sim_open", "loop.pace=board", *SLOWER)),
}
HERE = Path(__file__).parent
WATCHDOG_US = 100_000
ROUNDS = 60
MOST_S = 150
LEAST_COUNTS = 100
TRIES = 5
"""A run refuses to begin, with nothing moved, while the computer is too busy for its rate."""


@pytest.fixture
def run_on():
    """Starts a run on an emulated board."""
    with ExitStack() as stack:

        def start(board, kind, settings, out):
            chosen = [word for each in settings for word in ("--set", each)]
            command = [COMMAND, "run", "--board", f"{kind}:{board.link}", *chosen, "--out", out]
            command += ["--set", "experiment.start_speed_rad_s=100"]
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL}
            process = stack.enter_context(subprocess.Popen(command, text=True, **pipes))
            stack.callback(process.kill)
            return process

        yield start


@pytest.mark.parametrize("name", LOGICS)
def test_a_stop_through_the_emulated_board_completes_and_replays(name, run_on, tmp_path):
    kind, settings = LOGICS[name]
    with emulated_board(tmp_path) as board:
        for i in range(TRIES):
            out = tmp_path / f"{i}.mcap"
            said, _ = (run := run_on(board, kind, settings, out)).communicate(timeout=120)
            if run.returncode in {0, PROBLEMS}:
                break
        assert run.returncode in {0, PROBLEMS}, said
        assert "COMPLETED" in said
        changes = board.changes()
    assert any(drive > 0 and brake == 0 for drive, brake in (change.widths for change in changes))
    assert any(brake > 0 and drive == 0 for drive, brake in (change.widths for change in changes))
    assert changes[-1].widths == (0, 0)
    replayed = subprocess.run([COMMAND, "replay", out], capture_output=True, text=True, check=False)
    assert (replayed.returncode, "none differ" in replayed.stdout) == (0, True), replayed.stdout + replayed.stderr


def processes_of(supervisor):
    """Numbers of the processes of a run, by their name."""
    found = {"supervisor": supervisor}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            words = (process / "cmdline").read_text().split("\0")
        except (OSError, ValueError):
            continue
        if parent == supervisor:
            found |= {name: int(process.name) for name in ("loop", "guardian", "recorder") if name in words}
    return found


@pytest.mark.parametrize("victims", ["supervisor", "loop", "guardian", "recorder", "supervisor loop guardian recorder"])
def test_whatever_process_is_killed_the_outputs_go_off(victims, run_on, tmp_path):
    kind, settings = LOGICS["open logic"]
    with emulated_board(tmp_path) as board:
        run, tries = run_on(board, kind, settings, tmp_path / "0.mcap"), 0
        end = time.monotonic() + MOST_S
        while board.changes()[-1].widths[0] == 0 or len(board.changes()) < 4:
            assert time.monotonic() < end
            if run.poll() is not None:  # it refused to begin on a busy computer
                run.communicate()
                tries += 1
                run = run_on(board, kind, settings, tmp_path / f"{tries}.mcap")
            time.sleep(0.01)
        time.sleep(0.3)
        found, before = processes_of(run.pid), len(board.changes())
        for name in victims.split():
            os.kill(found[name], signal.SIGKILL)
        board.wait_until_off(before)
        last, off = board.changes()[-2:]
        run.communicate(timeout=60)
    if " " in victims:  # nothing is left but the board; its last command is older than its last change
        assert off.clock_us - last.clock_us >= WATCHDOG_US
        assert off.clock_us >= off.ticks_us[1]


def turned_by(command, driver):
    """Counts of the road after some exchanges with this command."""
    for _ in range(ROUNDS):
        newest = driver.exchange(command)
        time.sleep(0.02)
    return newest.road_count


@pytest.mark.parametrize(("kind", "config"), [("usb", "vendor_logic.toml"), ("open", "open_logic.toml")])
def test_the_picos_image_is_identified_spins_brakes_and_lets_go(kind, config, tmp_path):
    """By the program's own driver, on the file that is flashed."""
    configured = load_config(HERE / config, ["loop.rate_hz=50", "estimator.window_s=0.06"])
    with emulated_board(tmp_path, "rp2040") as board:
        first = driven = braked = 0
        for _ in range(TRIES):  # the emulator may be late for the driver's patience of 10 ms
            with (
                suppress(BoardError),
                punctual(),
                open_board(f"{kind}:{board.link}", configured, time.monotonic_ns) as driver,
            ):
                assert not driver.identity.read_only_because
                first = driver.exchange(Command.SAFE).road_count
                driven = turned_by(Command(1.0, 0.0), driver)
                braked = turned_by(Command(0.0, 0.6), driver)
            if braked > driven > first + LEAST_COUNTS:
                break
        board.wait_until_off()
        widths = [change.widths for change in board.changes()]
    assert braked > driven > first + LEAST_COUNTS
    assert max(drive for drive, _ in widths) > 4000
    assert max(brake for _, brake in widths) > 2000
