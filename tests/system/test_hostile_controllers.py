"""Controllers that do what no controller should, in real time: the board has one host, and the run an end."""

import signal
import time

import pytest
from live import LiveRun, safe_after_ns

from inteco_abs.realtime.memory import FOLDER, RunMemory, Word
from inteco_abs.signals import Reason

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]

LAW = """
import multiprocessing, os, threading, time
from inteco_abs.signals import BrakeDemand
class Law:
    gains = ()
    internals = ()
    updates = 0
    def __init__(self, setup):
        pass
    def update(self, estimate, dt_s):
        self.updates += 1
        if self.updates == 20:
            {}
        return BrakeDemand(0.6)
"""


@pytest.fixture
def run_with(command_path, tmp_path, untraced):
    """Runs a stop with a controller that executes a statement at its 20th update; run, exit code, card, messages."""

    def start(statement):
        (tmp_path / "law.py").write_text(LAW.format(statement))
        run = LiveRun(command_path, tmp_path, untraced, "--controller", "law.py:Law")
        return run, *run.end()

    return start


@pytest.mark.parametrize(
    "statement", ["os.fork()", pytest.param("os.fork() and time.sleep(0)", marks=pytest.mark.long)]
)
def test_a_forked_controller_makes_no_second_host(run_with, statement):
    run, code, card, message = run_with(statement)
    assert code in (0, 3), message
    session = run.session()
    assert session.incomplete == ""
    assert session.ticks["tick"].tolist() == list(range(run.ticks.written))
    assert card["link_errors"] == 0


@pytest.mark.long
def test_the_parent_of_a_fork_that_leaves_is_a_death(run_with):
    run, code, card, message = run_with("os.fork() and os._exit(0)")
    assert (code, card["outcome"]) == (5, "aborted"), message
    session = run.session()
    assert safe_after_ns(session, int(session.ticks["time_ns"][-1])) < 2_000_000_000
    assert len(session.ticks) == run.ticks.written


@pytest.mark.parametrize("kind", ["multiprocessing.Process", pytest.param("threading.Thread", marks=pytest.mark.long)])
def test_what_a_controller_leaves_running_does_not_hold_the_end(run_with, kind):
    run, code, card, message = run_with(f"{kind}(target=time.sleep, args=(600,)).start()")
    assert (code, card["outcome"]) in ((0, "completed"), (3, "completed"), (5, "fault")), message
    end = time.monotonic() + 10.0
    while run.processes() and time.monotonic() < end:
        time.sleep(0.05)
    assert run.processes() == []
    assert run.session().incomplete == ""


@pytest.mark.long
def test_an_error_with_a_book_for_its_text_is_the_controllers_all_the_same(run_with):
    run, code, card, _ = run_with("raise ValueError('long ' * 50_000)")
    assert (code, card["outcome"], card["reason"]) == (5, "fault", "CONTROLLER_ERROR")
    assert "ValueError: long long" in card["explanation"]
    assert run.session().ticks["reason"][-1] == Reason.CONTROLLER_ERROR


@pytest.mark.parametrize(
    "name", ["struct", *(pytest.param(name, marks=pytest.mark.long) for name in ("signal", "numpy"))]
)
def test_a_file_of_the_users_is_not_taken_for_a_library(command_path, tmp_path, untraced, name):
    (tmp_path / f"{name}.py").write_text("raise SystemExit('not the library')")
    run = LiveRun(command_path, tmp_path, untraced)
    code, card, message = run.end()
    assert code in (0, 3), message
    assert card["outcome"] == "completed"


@pytest.mark.long
def test_a_loop_that_is_stopped_before_its_first_tick_is_ended(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, begun=False)
    run.until(lambda: run.words[Word.READY] == run.words[Word.LOOP_PID] != 0)
    run.strike("loop", signal.SIGSTOP)
    code, _, _ = run.end(most_s=30.0)
    assert code != 0
    assert not run.memory.path.exists()


@pytest.mark.long
def test_without_a_guardian_that_takes_over_nothing_is_started(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, begun=False)
    run.strike("guardian", signal.SIGSTOP)  # while it is being loaded
    code, card, message = run.end(most_s=60.0)
    assert (code, card) == (1, None)
    assert "the guardian watches: not within 15 s" in message
    assert not (tmp_path / "stop.mcap").exists()
    assert not list(FOLDER.glob(run.memory.path.name))


def test_a_guardian_that_stands_still_is_replaced_when_the_loop_dies(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced)
    run.until_tick(400)
    run.strike("guardian", signal.SIGSTOP)
    struck_ns = run.strike("loop")
    code, card, message = run.end()
    assert (code, card["outcome"]) == (5, "aborted")
    assert "the supervisor made its board safe" in message
    assert safe_after_ns(run.session(), struck_ns) < 3_000_000_000


@pytest.mark.long
def test_many_stops_do_not_ask_for_all_the_memory_of_the_computer(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, "--set", "experiment.stops=1000")
    assert RunMemory.open(run.memory.path).tick_capacity <= 240_000
    run.process.send_signal(signal.SIGINT)
    code, _, _ = run.end()
    assert code == 130
