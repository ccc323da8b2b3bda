"""Controllers that do what no controller should, in real time: the board has one host, and the run an end."""

import os
import signal
import time

import pytest
from live import LiveRun, safe_after_ns

from inteco_abs.realtime.memory import FOLDER, Field, RunMemory
from inteco_abs.signals import Reason

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]

GENEROUS_NS = 2_000_000_000
"""No promise: what even a machine under load must keep."""
STEP = 1 / 255
"""Largest step of a PWM's width."""
LAW = """
import multiprocessing, os, signal, threading, time
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


BYPASS = """
import gc
import inteco_abs.boards.board, inteco_abs.control.guard, inteco_abs.control.pipeline, inteco_abs.realtime
from inteco_abs.control import Guard, Pipeline
from inteco_abs.signals import BrakeDemand, Command
def admit(k, s, sample, drive, brake):
    s.drive, s.brake = drive, brake
guard, pipeline = inteco_abs.control.guard, inteco_abs.control.pipeline
guard.admit = pipeline.admit = admit
guard.trip = pipeline.trip = lambda s, reason: None
Guard.admit = lambda self, requested, *more: requested
Pipeline.command = Command.SAFE = Command(1.0, 1.0)
class Law:
    gains = internals = ()
    def __init__(self, setup):
        pass
    def update(self, estimate, dt_s):
        for one in gc.get_objects():
            if isinstance(one, Guard):
                for limit in ("brake_limit", "drive_limit", "over_speed"):
                    object.__setattr__(one.k, limit, 1e9)
            if isinstance(one, dict) and "brake_limit" in one:
                one["brake_limit"] = 1.0
        Law.update = lambda self, estimate, dt_s: BrakeDemand(1.0)
        return BrakeDemand(1.0)
"""
"""Takes the guard's limits away in every way that Python offers."""


@pytest.fixture
def run_with(command_path, tmp_path, untraced):
    """Runs a stop with a controller that executes a statement at its 20th update; run, exit code, card, messages."""

    def start(statement, *arguments, source=LAW, **options):
        (tmp_path / "law.py").write_text(source.format(statement) if statement else source)
        run = LiveRun(command_path, tmp_path, untraced, "--controller", "law.py:Law", *arguments, **options)
        return run, *run.end()

    return start


@pytest.mark.long
@pytest.mark.parametrize("statement", ["os.fork()", "os.fork() and time.sleep(0)"])
def test_a_forked_controller_makes_no_second_host(run_with, statement):
    run, code, card, message = run_with(statement)
    assert code in (0, 3), message
    session = run.session()
    assert session.incomplete == ""
    assert session.ticks["tick"].tolist() == list(range(run.ticks.written))
    assert card["link_errors"] < 0.01 * card["ticks"]  # a busy computer's; two hosts get each other's answers


@pytest.mark.parametrize("limit", ["0.7", pytest.param("0.3", marks=pytest.mark.long)])
def test_no_controller_changes_what_the_guard_lets_through(run_with, limit):
    run, _, card, message = run_with("", "--set", f"guard.brake_limit={limit}", source=BYPASS)
    assert card is not None, message
    session = run.session()
    braked = session.truth["brake"].max()
    assert 0.9 * float(limit) < braked <= float(limit) + STEP
    assert ((session.truth["drive"] == 0.0) | (session.truth["brake"] == 0.0)).all()
    assert session.ticks["brake_request"].max() == 1.0
    assert safe_after_ns(session, int(session.ticks["time_ns"][-1])) < GENEROUS_NS


HANGS = "law.py:Law has not answered for 20 ms"
ENDS = {
    "os._exit(3)": "law.py:Law has ended its process: exit code 3",
    "os.kill(os.getpid(), signal.SIGKILL)": "law.py:Law has ended its process: SIGKILL",
    "os.kill(os.getpid(), signal.SIGSEGV)": "law.py:Law has ended its process: SIGSEGV",
    "os.fork() and os._exit(0)": "law.py:Law has ended its process: exit code 0",
    "raise KeyboardInterrupt": "KeyboardInterrupt",
    "time.sleep(600)": HANGS,
    "exec('while True: pass')": HANGS,
    "os.kill(os.getpid(), signal.SIGSTOP)": HANGS,
    "os.kill(os.getppid(), signal.SIGTERM) or time.sleep(600)": HANGS,
}


@pytest.mark.long
@pytest.mark.parametrize("statement", ENDS)
def test_dead_or_hung_controller_is_its_own_error_and_the_loop_ends_safe(run_with, statement):
    run, code, card, message = run_with(statement)
    assert (code, card["outcome"], card["reason"]) == (5, "fault", "CONTROLLER_ERROR"), message
    # a loaded computer may take more than 20 ms to end a process
    assert ENDS[statement] in card["explanation"] or HANGS in card["explanation"]
    assert_stopped(run)


@pytest.mark.long
@pytest.mark.parametrize("statement", ["exec('while True: pass')", "time.sleep(600)"])
def test_one_that_hangs_on_a_single_cpu_is_ended_there_too(run_with, statement):
    run, code, card, message = run_with(statement, preexec_fn=lambda: os.sched_setaffinity(0, {0}))
    assert code == 5, message
    assert card["outcome"] in {"fault", "aborted"}  # a loaded computer may lose ticks, or the guardian step in, before
    assert_stopped(run)


def assert_stopped(run):
    """The session is whole, its last tick SAFE, and the board off at once, by its own record."""
    session = run.session()
    assert session.incomplete == ""
    assert len(session.ticks) == run.ticks.written
    asked = session.ticks["time_ns"][session.ticks["brake"] > 0.0]
    assert safe_after_ns(session, int(asked[-1])) < GENEROUS_NS
    assert run.processes() == []


@pytest.mark.long
@pytest.mark.parametrize("kind", ["multiprocessing.Process", "threading.Thread"])
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


@pytest.mark.long
@pytest.mark.parametrize("name", ["struct", "signal", "numpy"])
def test_a_file_of_the_users_is_not_mistaken_for_a_library(command_path, tmp_path, untraced, name):
    (tmp_path / f"{name}.py").write_text("raise SystemExit('not the library')")
    run = LiveRun(command_path, tmp_path, untraced)
    code, card, message = run.end()
    assert code in (0, 3), message
    assert card["outcome"] == "completed"


@pytest.mark.long
def test_a_loop_that_is_stopped_before_its_first_tick_is_ended(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, begun=False)
    run.until(lambda: run.words[Field.READY] == run.words[Field.LOOP_PID] != 0)
    run.kill("loop", signal.SIGSTOP)
    code, _, _ = run.end(most_s=30.0)
    assert code != 0
    assert not run.memory.path.exists()


@pytest.mark.long
def test_without_a_guardian_that_takes_over_nothing_is_started(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, begun=False)
    run.kill("guardian", signal.SIGSTOP)  # while it is being loaded
    code, card, message = run.end(most_s=60.0)
    assert (code, card) == (1, None)
    assert "the guardian watches: not within 15 s" in message
    assert not (tmp_path / "stop.mcap").exists()
    assert not list(FOLDER.glob(run.memory.path.name))


@pytest.mark.long
def test_a_frozen_guardian_is_replaced_when_the_loop_dies(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced)
    run.until_tick(400)
    run.kill("guardian", signal.SIGSTOP)
    killed_ns = run.kill("loop")
    code, card, message = run.end()
    assert (code, card["outcome"]) == (5, "aborted")
    assert "the supervisor made its board safe" in message
    assert safe_after_ns(run.session(), killed_ns) < 3_000_000_000


@pytest.mark.long
def test_many_stops_do_not_ask_for_all_the_memory_of_the_computer(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, "--set", "experiment.stops=1000")
    assert RunMemory.open(run.memory.path).tick_capacity <= 240_000
    run.process.send_signal(signal.SIGINT)
    code, _, _ = run.end()
    assert code == 130
