"""Every process of a real-time run killed, stopped or left alone: SAFE at the board, and not a tick lost."""

import fcntl
import json
import os
import random
import resource
import shutil
import signal
import termios
import time
from pathlib import Path

import process_faults
import pytest
import tracing
from killed_run import KINDS, RUNS, run_and_kill, table
from live import STARTS, safe_after_ns

from inteco_abs.realtime.memory import Field
from inteco_abs.signals import Phase, Reason
from tests.faults.protocol import unexplained

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]

GENEROUS_NS = 2_000_000_000
"""No promise: what even a machine under load must keep. Figures come from tools/bench_deaths."""
STEP = 1 / 255
"""Largest step of a PWM's width."""
FREEZER = Path("/sys/fs/cgroup/freezer")
TURNING = 400
"""A tick by which the drive is on."""


def assert_nothing_lost(run, replayed):
    session = run.session()
    assert session.incomplete == ""
    assert len(session.ticks) == run.ticks.written
    assert session.ticks["tick"].tolist() == list(range(run.ticks.written))
    assert replayed(run.out)["differing"] == 0
    # every command that the board got, the last one too, is the decision of a recorded tick
    decided = {(0.0, 0.0), *commands(session.ticks)}
    report = commands(session.truth)
    strange = [one for one in report if not any(max(abs(one[i] - of[i]) for i in (0, 1)) < STEP for of in decided)]
    assert strange == []
    return session


def commands(rows):
    return set(zip(rows["drive"].tolist(), rows["brake"].tolist(), strict=True))


@pytest.fixture
def replayed(main_here):
    """Replays a session in this process: what matters is another one than the run's."""

    def again(path):
        return json.loads(tracing.untraced(main_here, "replay", path, "--json").stdout)

    return again


def assert_left_nothing_behind(run):
    end = time.monotonic() + 10.0
    while run.processes() and time.monotonic() < end:
        time.sleep(0.05)
    assert run.processes() == []
    assert not run.memory.path.exists()
    assert not run.memory.socket.exists()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 60))])
def test_a_loop_that_is_killed_at_any_moment_leaves_safe_and_every_tick(live, replayed, seed):
    moment = random.Random(seed)
    run = live()
    run.until_tick(moment.randrange(1, 3300))
    time.sleep(moment.random() * 0.0005)
    killed_ns = run.kill("loop")
    code, card, message = run.end()
    assert code == 5, message
    assert (card["outcome"], card["lost_ticks"], card["ticks"]) == ("aborted", 0, run.ticks.written)
    session = assert_nothing_lost(run, replayed)
    assert safe_after_ns(session, killed_ns) < GENEROUS_NS
    reason = session.metadata["session"]["reason"]
    assert f"died after tick {run.ticks.written - 1}; the guardian made its board safe in" in reason
    assert reason in message
    assert_left_nothing_behind(run)


@pytest.mark.long
def test_a_loop_that_is_killed_leaves_no_raw_frames_and_the_session_says_so(live, replayed):
    run = live("--frames")
    run.until_tick(TURNING)
    run.kill("loop")
    code, card, message = run.end()
    assert (code, card["outcome"], card["lost_ticks"]) == (5, "aborted", 0)
    missing = "the loop's process ended before it had saved them"
    assert missing in message
    session = assert_nothing_lost(run, replayed)
    assert (session.frames, session.metadata["frames"]) == (0, {"missing": missing})
    assert_left_nothing_behind(run)


@pytest.mark.long
def test_without_a_recorder_the_raw_frames_are_in_the_session_too(live, replayed):
    run = live("--frames")
    run.until_tick(TURNING)
    run.kill("recorder")
    assert run.end()[0] == 5
    session = assert_nothing_lost(run, replayed)
    assert session.frames > 2 * len(session.ticks)
    assert_left_nothing_behind(run)
    assert not run.memory.frames.exists()


@pytest.mark.long
def test_a_loop_that_hangs_is_killed_by_the_guardian(live, replayed):
    run = live()
    run.until_tick(TURNING)
    stopped_ns = run.kill("loop", signal.SIGSTOP)
    code, card, message = run.end()
    assert (code, card["outcome"]) == (5, "aborted")
    assert "the loop's process hung and was killed" in message
    session = assert_nothing_lost(run, replayed)
    assert 0 < safe_after_ns(session, stopped_ns) < GENEROUS_NS
    assert_left_nothing_behind(run)


HANGING = """
import sys
if "loop" in sys.orig_argv:
    from inteco_abs.control import ReachingLaw
    update, updates = ReachingLaw.update, []
    def hang(*what):
        updates.append(what)
        while len(updates) == 50:
            pass
        return update(*what)
    ReachingLaw.update = hang
"""
"""Python runs this before all else, in each process."""


def all_cpus():
    pass


def one_cpu():
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


@pytest.mark.long
@pytest.mark.parametrize("confined", [all_cpus, one_cpu])
def test_a_loop_that_never_yields_its_cpu_is_ended_by_the_guardian(live, tmp_path, untraced, monkeypatch, confined):
    (tmp_path / "sitecustomize.py").write_text(HANGING)
    monkeypatch.setitem(untraced, "PYTHONPATH", str(tmp_path))
    run = live(preexec_fn=confined)
    code, card, message = run.end()
    assert (code, card["outcome"]) == (5, "aborted")
    assert "hung and was killed" in message
    session = run.session()
    assert session.ticks["phase"][-1] == Phase.BRAKING
    assert session.ticks["brake"][-1] > 0.0
    assert len(session.ticks) == run.ticks.written
    assert safe_after_ns(session, int(session.ticks["time_ns"][-1])) < GENEROUS_NS
    assert_left_nothing_behind(run)


@pytest.mark.parametrize(
    ("role", "reason", "number"),
    [
        # each role once, as the run with raw frames kills the recorder; the rest with those that take long
        ("guardian", Reason.GUARDIAN_LOST, signal.SIGSTOP),
        pytest.param("recorder", Reason.RECORDER_LOST, signal.SIGKILL, marks=pytest.mark.long),
        pytest.param("guardian", Reason.GUARDIAN_LOST, signal.SIGKILL, marks=pytest.mark.long),
        pytest.param("recorder", Reason.RECORDER_LOST, signal.SIGSTOP, marks=pytest.mark.long),
    ],
)
def test_without_guardian_or_recorder_the_loop_stops_safely(live, replayed, role, reason, number):
    run = live()
    run.until_tick(TURNING)
    killed_ns = run.kill(role, number)
    code, card, message = run.end()
    assert code == 5, message
    assert (card["outcome"], card["reason"], card["lost_ticks"]) == ("fault", reason.name, 0)
    session = assert_nothing_lost(run, replayed)
    assert session.ticks["stop_request"][-1] == reason
    assert safe_after_ns(session, killed_ns) < GENEROUS_NS
    assert session.metadata["session"]["died"] == role
    if role == "recorder":
        assert "made from what the run left in memory" in message
    assert_left_nothing_behind(run)


def test_without_supervisor_the_run_stops_safely_and_the_recorder_finishes_the_file(live, replayed):
    run = live()
    run.until_tick(TURNING)
    killed_ns = run.kill("supervisor")
    run.process.communicate(timeout=30)
    assert_left_nothing_behind(run)
    session = assert_nothing_lost(run, replayed)
    assert session.metadata["session"]["outcome"] == "fault"
    assert session.metadata["session"]["died"] == "supervisor"
    assert session.ticks["reason"][-1] == Reason.SUPERVISOR_LOST
    assert safe_after_ns(session, killed_ns) < GENEROUS_NS


@pytest.mark.long
def test_a_supervisor_that_is_stopped_counts_as_gone(live, replayed):
    run = live("--set", "experiment.start_speed_rad_s=90")
    run.until_tick(TURNING)
    run.kill("supervisor", signal.SIGSTOP)
    run.until(lambda: not run.words[Field.HOLDER_PID])
    run.kill("supervisor", signal.SIGCONT)
    code, card, _ = run.end()
    assert (code, card["reason"]) == (5, "SUPERVISOR_LOST")
    assert_nothing_lost(run, replayed)
    assert_left_nothing_behind(run)


@pytest.mark.long
def test_loop_and_guardian_killed_at_once_leave_the_supervisor(live, replayed):
    """Not guaranteed: with all three gone only the emergency switch is left."""
    run = live()
    run.until_tick(TURNING)
    pids, killed_ns = [run.pid("loop"), run.pid("guardian")], time.monotonic_ns()
    for pid in pids:  # either ends the run within milliseconds, if it is left
        os.kill(pid, signal.SIGKILL)
    code, card, _ = run.end()
    assert (code, card["outcome"], card["lost_ticks"]) == (5, "aborted", 0)
    session = assert_nothing_lost(run, replayed)
    assert safe_after_ns(session, killed_ns) < GENEROUS_NS
    assert session.metadata["session"]["died"] == "loop, guardian"
    assert_left_nothing_behind(run)


@pytest.mark.long
@pytest.mark.parametrize("kind", process_faults.KINDS, ids=process_faults.name_of)
def test_killed_or_frozen_processes_leave_the_board_safe_or_the_user_warned(command_path, tmp_path, untraced, kind):
    found = process_faults.run_with_faults(command_path, tmp_path, untraced, kind, 0)
    assert unexplained(found.trace, len(kind), {}) is None, found
    if process_faults.any_actor_left(kind):
        assert found.off_ms * 1e6 < GENEROUS_NS, found
    else:
        assert found.off_ms < float("inf") or found.warned, found


@pytest.fixture
def undying():
    """Makes a process one that cannot be killed until this is over, as one that waits in the kernel for a device."""
    folder = FREEZER / f"inteco-abs-{os.getpid()}"
    try:
        folder.mkdir()
    except OSError as error:
        pytest.skip(f"no cgroup of version 1 that freezes, whose processes no signal reaches: {error}")

    def freeze(pid):
        (folder / "cgroup.procs").write_text(str(pid))
        (folder / "freezer.state").write_text("FROZEN")

    def thaw():
        (folder / "freezer.state").write_text("THAWED")

    yield freeze, thaw
    thaw()
    while (folder / "cgroup.procs").read_text():
        time.sleep(0.01)
    folder.rmdir()


@pytest.mark.long
@pytest.mark.parametrize(
    "victims",
    [
        (),
        ("guardian", "supervisor"),
        ("guardian",),
        ("supervisor",),
        ("guardian", "recorder"),
        ("supervisor", "recorder"),
    ],
    ids=lambda victims: "+".join(victims) or "none",
)
def test_a_loop_that_cannot_be_killed_is_reported_at_once_by_a_process_that_is_left(live, undying, victims):
    freeze, thaw = undying
    run = live()
    run.until_tick(TURNING)
    doomed = [run.pid(role) for role in victims]
    freeze(run.pid("loop"))
    for pid in doomed:
        os.kill(pid, signal.SIGKILL)
    assert run.memory.wait(lambda: run.words[Field.ALARMED], GENEROUS_NS * 1e-9)
    thaw()
    if "supervisor" in victims:
        message = run.process.communicate(timeout=60)[1]
    else:
        code, card, message = run.end()
        assert (code, card["outcome"]) == (5, "aborted")
        assert "made its board safe in" in message
    assert message.count("MOTOR POWER MAY STILL BE ON: press the emergency switch") == 1


@pytest.mark.long  # tests/emulation/test_link_errors.py and the fault campaign have it by other links
def test_a_lost_board_is_reported_prominently(live):
    run = live()
    run.until_tick(TURNING)
    run.kill("board")
    code, card, message = run.end()
    assert (code, card["outcome"], card["reason"]) == (5, "aborted", "MISSED_EXCHANGES")
    assert "MOTOR POWER MAY STILL BE ON: press the emergency switch" in message
    assert card["ticks"] == run.ticks.written
    assert_left_nothing_behind(run)


def test_everything_killed_at_once_leaves_every_tick_in_memory(live, inteco_abs, replayed, tmp_path):
    run = live()
    run.until_tick(TURNING)
    # by number: a process that sees another end may end before it is looked up by name
    for pid in [run.pid(role) for role in ("supervisor", "guardian", "recorder", "loop", "board")]:
        os.kill(pid, signal.SIGKILL)
    run.process.communicate()
    again = tmp_path / "again.mcap"
    lost = inteco_abs("recover", run.memory.path, "--out", again, "--json", check=0)
    assert f'"ticks": {run.ticks.written}' in lost.stdout
    assert replayed(again)["differing"] == 0
    assert not run.memory.path.exists()


def go_through(command_path, tmp_path, untraced, victims, numbers):
    found = []
    for number in numbers:
        (tmp_path / str(number)).mkdir(parents=True)
        found.append(run_and_kill(command_path, tmp_path / str(number), untraced, victims, number))
    return found


def test_every_tick_is_recovered_from_memory_after_both_processes_die(command_path, tmp_path, untraced):
    at_once = 7  # before the one notices that the other is gone
    for attempt in range(STARTS):  # a busy computer may not begin
        place = tmp_path / f"attempt {attempt}"
        (found,) = go_through(command_path, place, untraced, ("recorder", "supervisor"), [at_once])
        if found.packed:
            break
    assert found.passed, found
    assert found.recovered
    assert found.kept > 0


@pytest.mark.long
@pytest.mark.parametrize("victims", KINDS, ids="+".join)
def test_every_tick_is_kept_whenever_processes_die(command_path, tmp_path, untraced, record_property, victims):
    found = go_through(command_path, tmp_path, untraced, victims, range(RUNS))
    record_property("figures", "\n".join(list(table({victims: found}))[:2]))
    assert [each for each in found if not each.passed] == []
    assert any(each.kept for each in found)


@pytest.mark.long
def test_the_next_run_reports_a_crashed_runs_remains(live, tmp_path):
    run = live()
    run.until_tick(TURNING)
    for role in ("supervisor", "guardian", "recorder", "loop", "board"):
        run.kill(role)
    run.process.communicate()
    again = live("--out", tmp_path / "next.mcap")
    again.process.send_signal(signal.SIGINT)
    _, _, message = again.end()
    assert f"inteco-abs recover {run.memory.path}" in message


def no_more_room(run, role):
    resource.prlimit(run.pid(role), resource.RLIMIT_FSIZE, (10_000, 10_000))


@pytest.mark.long  # tests/faults/test_keeper_machine.py has it in any order, in virtual time
def test_a_disk_that_refuses_ends_no_run_and_the_file_is_made_from_memory(live, replayed):
    run = live()
    run.until_tick(TURNING)
    no_more_room(run, "recorder")
    code, card, message = run.end()
    assert (code, card["outcome"], card["lost_ticks"]) == (3, "completed", 0), message
    assert "the run continues, and its ticks are kept in memory" in message
    assert f"the whole session is in {run.out}" in message
    assert_nothing_lost(run, replayed)
    assert_left_nothing_behind(run)


@pytest.mark.long
def test_run_continues_in_the_second_place_when_the_folder_vanishes(live, replayed, tmp_path):
    spill = tmp_path / "spill"
    spill.mkdir()
    (tmp_path / "out").mkdir()
    run = live("--out", tmp_path / "out" / "stop.mcap", "--set", f"session.spill={spill}")
    run.until_tick(TURNING)
    shutil.rmtree(tmp_path / "out")
    code, card, message = run.end()
    run.out = spill / "stop.mcap"
    assert (code, card["outcome"], card["session"]) == (3, "completed", str(run.out)), message
    assert f"the run continues, and it is now written to {run.out}" in message
    assert_nothing_lost(run, replayed)
    assert_left_nothing_behind(run)


@pytest.mark.long
def test_a_disk_that_keeps_refusing_leaves_the_ticks_in_memory(live, inteco_abs, replayed, tmp_path):
    run = live()
    run.until_tick(TURNING)
    for role in ("supervisor", "recorder"):
        no_more_room(run, role)
    code, card, message = run.end()
    assert (code, card) == (3, None), message
    assert "stopped safely, but" in message
    ring = str(run.memory.path)
    assert f"inteco-abs recover {ring} --out FILE" in message
    assert not list(tmp_path.glob("*.part"))
    again = tmp_path / "again.mcap"
    inteco_abs("recover", ring, "--out", again, check=0)
    assert replayed(again)["ticks"] == run.ticks.written


# handle_signals gives all of them one handler in one loop; SIGINT comes from a keyboard below
@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        *(
            pytest.param(each, marks=pytest.mark.long)
            for each in (signal.SIGTSTP, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
        ),
    ],
    ids=lambda number: number.name,
)
def test_a_signal_ends_a_run_with_a_complete_session(live, replayed, number):
    run = live()
    run.until_tick(TURNING)
    killed_ns = run.kill("supervisor", number)
    code, card, _ = run.end()
    assert (code, card["outcome"], card["reason"]) == (130, "interrupted", "OPERATOR_STOP")
    assert safe_after_ns(assert_nothing_lost(run, replayed), killed_ns) < GENEROUS_NS
    assert_left_nothing_behind(run)


@pytest.fixture
def terminal():
    """A terminal that a command can be run in: the user's end, and what the command needs."""
    ours, theirs = os.openpty()

    def control():
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    closed = []

    def close():
        if not closed:
            closed.append(True)
            os.close(ours)

    yield ours, close, {"stdin": theirs, "preexec_fn": control}
    close()
    os.close(theirs)


@pytest.mark.long
def test_control_c_twice_ends_in_safe_once(live, replayed, terminal):
    keyboard, _, options = terminal
    run = live(**options)
    run.until_tick(TURNING)
    os.write(keyboard, b"\x03")
    time.sleep(0.001)
    os.write(keyboard, b"\x03")
    code, card, _ = run.end()
    assert (code, card["outcome"]) == (130, "interrupted")
    assert_nothing_lost(run, replayed)
    assert_left_nothing_behind(run)


@pytest.mark.long
def test_a_terminal_that_is_closed_ends_the_run_safely(live, replayed, terminal):
    _, close, options = terminal
    run = live(**options)
    run.until_tick(TURNING)
    close()
    code, card, _ = run.end()
    assert (code, card["outcome"]) == (130, "interrupted")
    assert_nothing_lost(run, replayed)
    assert_left_nothing_behind(run)
