"""A supervisor's whole run in a time of its own; the processes that it starts only sleep, and a director plays them."""

import os
import signal
import subprocess
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from types import SimpleNamespace

import pytest

from inteco_abs.errors import BoardError, SessionError, UnsafeError
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.realtime.processes import supervisor as supervisor_module
from inteco_abs.realtime.processes.supervisor import Supervisor
from inteco_abs.realtime.screen import NoScreen, StartCheck
from inteco_abs.sessions import TICK, RunResult, pack_tick
from inteco_abs.signals import EXPLANATIONS, Reason

RESULT = RunResult("completed", Reason.NONE, "all is well", {"ticks": 1})
SETTINGS = [
    {"name": "scheduler", "value": "default", "refused": "no right"},
    {"name": "memory", "value": "locked", "refused": ""},
]
RESCUE = {"failure": "", "done_ns": 10**12 + 4_000_000, "by": "guardian", "cause": "died"}


class Noting(NoScreen):
    def __init__(self):
        self.seen, self.notes, self.warnings, self.shown = [], [], [], 0

    def passed(self, check, posted=""):
        self.seen.append((check, posted))

    def note(self, text):
        self.notes.append(text)

    def warn(self, text):
        self.warnings.append(text)

    def show(self, _snapshot):
        self.shown += 1


class NoWatch:
    """In the place of the watch: does nothing."""

    def __init__(self, _memory, _job, loop_pid, guardian_pid):
        self.pids = (loop_pid, guardian_pid)
        self.judging = False
        self.main_ns, self.failure = None, ""

    @contextmanager
    def watching(self):
        yield


class Staged(Supervisor):
    """Each pause of the supervisor's is the director's turn, and lasts as long as it asks for."""

    def __init__(self, memory, job, child):
        super().__init__(memory, job)
        self.memory, self.words, self.children = memory, memory.words, self._children
        self.child, self.now_s, self.turns, self.screen = child, 1000.0, 0, Noting()
        self.ticks = memory.tick_ring(pack_tick)
        self.runs_s, self.went_s = 1.0, None

    def spawn(self, name, module, *arguments):
        assert (module, arguments[1:]) == ("inteco_abs.realtime.processes", (str(self.memory.path),))
        self.children[name] = process = self.child()
        kill = process.kill
        process.kill = lambda: (kill(), process.wait())  # the director's time would go on until it has ended

    def kill(self, name):
        self.children[name].kill()

    def sleep(self, seconds):
        self.now_s += seconds
        self.turns += 1
        assert self.turns < 200_000
        self.direct()

    def direct(self):
        """All goes well."""
        words, loop, drill = self.words, self.children.get("loop"), self.children.get("drill")
        if drill is not None:
            if words[Field.GUARDING_PID] == words[Field.GUARDED_PID] == drill.pid:
                self.memory.post(Mailbox.SAFE_IMAGE, b"all zero")
                self.memory.post(Mailbox.RESCUE, RESCUE)
                words[Field.READY] = words[Field.RESCUED_PID] = drill.pid
            words[Field.GUARDING_PID] = words[Field.GUARDED_PID]
        elif words[Field.GUARDED_PID] == loop.pid != words[Field.READY]:
            words[Field.READY] = words[Field.HOLDER_PID] = loop.pid
            posted = {"identity": {}, "gains": {}, "internals": [], "settings": SETTINGS}
            self.memory.post(Mailbox.HEADER, posted)
        elif not words[Field.GO]:
            words[Field.RECORDING] = 1
        else:
            assert words[Field.RECORDING]
            self.drive()

    def drive(self):
        self.went_s = self.went_s or self.now_s
        if not self.ticks.written:
            self.ticks.append([0] * len(TICK.columns))
        if self.now_s - self.went_s > self.runs_s:
            self.end_well()

    def end_well(self):
        self.words[Field.HOLDER_PID] = 0
        self.memory.post(Mailbox.RESULT, asdict(RESULT) | {"reason": int(RESULT.reason)})
        self.kill("recorder")
        self.kill("loop")


@pytest.fixture
def memory(new_memory):
    return new_memory(10_000, 10_000)  # less room would end the run


@pytest.fixture
def staged(memory, job_of, child, monkeypatch):
    made = Staged(memory, job_of(memory), child)
    clock = SimpleNamespace(
        sleep=made.sleep, monotonic=lambda: made.now_s, monotonic_ns=lambda: round(made.now_s * 1e9)
    )
    made.tunings = []
    for name, value in (("time", clock), ("ProcessWatch", NoWatch), ("_END_S", 0.0), ("_FINISH_S", 0.0)):
        monkeypatch.setattr(supervisor_module, name, value)
    monkeypatch.setattr(supervisor_module, "apply", made.tunings.append)
    monkeypatch.setattr(supervisor_module, "handle_signals", lambda _stop: nullcontext())
    monkeypatch.setattr(memory, "wait", lambda condition, _most_s: condition())
    return made


def test_a_normal_run_drills_releases_shows_and_returns_the_recorders_result(staged):
    assert staged.run(staged.screen) == RESULT
    checks, posted = zip(*staged.screen.seen, strict=True)
    assert checks == (StartCheck.BOARD, StartCheck.GUARDIAN, StartCheck.RECORDER)
    assert posted[0] == "sim:"
    assert staged.memory.note(Mailbox.DRILL) == {"guardian drill": posted[1]}
    assert staged.screen.notes == ["ticks will be late more often: the system refused scheduler; see inteco-abs doctor"]
    assert 9 <= staged.screen.shown <= 13
    assert staged._watch.judging
    assert staged._watch.pids == (staged.children["loop"].pid, staged.children["guardian"].pid)
    assert len(staged.tunings) == 1
    assert staged.words[Field.OVER] == 1
    assert staged.words[Field.STOP] == 0
    assert all(process.poll() is not None for process in staged.children.values())


def test_the_processors_that_it_may_use_are_those_from_before(staged, monkeypatch):
    before = os.sched_getaffinity(0)
    one = {min(before)}
    os.sched_setaffinity(0, one)
    try:
        monkeypatch.setattr(supervisor_module, "apply", lambda _tunings: os.sched_setaffinity(0, before))
        staged.run(staged.screen)
        assert os.sched_getaffinity(0) == one
    finally:
        os.sched_setaffinity(0, before)


def test_without_a_terminal_what_processes_print_goes_nowhere(memory, job_of, monkeypatch):
    started = {}
    monkeypatch.setattr(supervisor_module.sys, "stderr", None)
    monkeypatch.setattr(supervisor_module.subprocess, "Popen", lambda _words, **how: started.update(how))
    Supervisor(memory, job_of(memory)).spawn("loop", "code")
    assert started["stdin"] == started["stdout"] == subprocess.DEVNULL
    assert started["env"]["OPENBLAS_NUM_THREADS"] == "1"


def test_the_live_view_is_announced(staged):
    staged.words[Field.LIVE_PORT] = 8765
    staged.run(staged.screen)
    assert "8765" in staged.screen.notes[0]


def test_a_stop_before_the_run_begins_is_not_an_error(staged):
    staged.direct = staged._stop
    with pytest.raises(KeyboardInterrupt):
        staged.run(staged.screen)
    assert staged.words[Field.STOP] == Reason.OPERATOR_STOP
    assert staged.words[Field.GO] == 0


@pytest.mark.parametrize("name", ["guardian", "recorder", "loop"])
def test_a_process_that_ends_before_the_run_is_named(staged, name):
    staged.direct = lambda: staged.kill(name)
    staged.words[Field.GUARDIAN_STOP] = Reason.SUPERVISOR_LOST
    with pytest.raises(BoardError, match=f"the {name} process ended before the run began .exit code -9.: ") as caught:
        staged.run(staged.screen)
    assert str(caught.value).endswith(f"{EXPLANATIONS[Reason.SUPERVISOR_LOST]}; nothing was started")


@pytest.mark.parametrize(
    ("name", "note"), [("recorder", Mailbox.RECORDER_FAILURE), ("loop", Mailbox.FAILURE)], ids=["recorder", "loop"]
)
def test_what_a_process_said_before_it_ended_is_raised(staged, name, note):
    def ends():
        staged.memory.post(note, {"kind": "SessionError", "text": "no room", "notes": []})
        staged.kill(name)

    staged.direct = ends
    with pytest.raises(SessionError, match="no room"):
        staged.run(staged.screen)


def test_what_never_comes_is_waited_for_so_long_and_then_named(staged):
    staged.direct = lambda: None
    began_s = staged.now_s
    with pytest.raises(BoardError, match="the guardian watches: not within 15 s, waiting for the guardian process"):
        staged.run(staged.screen)
    assert 15.0 < staged.now_s - began_s < 15.1


def test_a_recorder_that_dies_while_the_loop_runs_ends_the_run(staged):
    def dies():
        staged.ticks.written or staged.ticks.append([0] * len(TICK.columns))
        staged.kill("recorder")
        if staged.words[Field.STOP]:
            staged.end_well()

    staged.drive = dies
    assert staged.run(staged.screen) == RESULT
    assert staged.words[Field.STOP] == Reason.RECORDER_LOST


@pytest.mark.parametrize(("saving", "most_s"), [(0, 2.0), (1, 30.0)])
def test_a_loop_that_released_the_board_may_save_before_it_is_killed(staged, saving, most_s):
    def lingers():
        if not staged.ticks.written:
            staged.went_s = staged.now_s
            staged.ticks.append([0] * len(TICK.columns))
            staged.memory.post(Mailbox.RESULT, asdict(RESULT) | {"reason": 0})
        staged.words[Field.HOLDER_PID], staged.words[Field.SAVING] = 0, saving

    staged.drive = lingers
    staged.run(staged.screen)
    assert staged.children["loop"].returncode == -signal.SIGKILL
    assert most_s <= staged.now_s - staged.went_s < most_s + 0.2


def test_a_board_that_was_left_unsafe_is_warned_of_at_once(staged):
    def fails():
        staged.memory.post(Mailbox.FAILURE, {"kind": "UnsafeError", "text": "SAFE could not be confirmed", "notes": []})
        staged.end_well()

    staged.drive = fails
    staged.run(staged.screen)
    assert staged.screen.warnings == ["SAFE could not be confirmed"]


@pytest.mark.parametrize(
    ("stop", "failure", "error", "words"),
    [
        (Reason.OPERATOR_STOP, None, KeyboardInterrupt, None),
        (Reason.GUARDIAN_LOST, None, SessionError, EXPLANATIONS[Reason.GUARDIAN_LOST]),
        (0, {"kind": "UnsafeError", "text": "it is on", "notes": []}, UnsafeError, "it is on"),
    ],
    ids=["stopped", "a process is lost", "the loop failed"],
)
def test_a_run_without_a_tick_has_no_result_but_a_reason(staged, stop, failure, error, words):
    def ends():
        staged.words[Field.STOP] = stop
        if failure:
            staged.memory.post(Mailbox.FAILURE, failure)
        staged.words[Field.HOLDER_PID] = 0
        staged.kill("loop")

    staged.drive = ends
    with pytest.raises(error, match=words):
        staged.run(staged.screen)


class TestTheSecondWay:
    """Where the recorder leaves no result."""

    @pytest.fixture
    def ends(self, staged, monkeypatch):
        """A run whose recorder has failed or died, and whose session is made by `rebuild`."""

        def run(rebuild, failure=None):
            def ended():
                if failure:
                    posted = {"kind": "SessionError", "text": failure, "notes": []}
                    staged.memory.post(Mailbox.RECORDER_FAILURE, posted)
                staged.words[Field.HOLDER_PID] = 0
                staged.kill("loop")

            staged.drive = ended
            monkeypatch.setattr(supervisor_module, "rebuild", rebuild)
            return staged.run(staged.screen)

        return run

    def test_the_session_is_made_from_memory(self, staged, ends):
        recorders = []
        assert ends(lambda *_: recorders.append(staged.children["recorder"].returncode) or RESULT) == RESULT
        assert recorders == [-signal.SIGKILL]  # two would write the file

    def test_what_kept_the_recorder_from_it_is_reported(self, staged, ends):
        posted = ends(lambda *_: RESULT, "no room")
        assert posted.trouble == f"no room; the whole session is in {staged._job.session}"

    def test_where_no_disk_accepts_it_the_ticks_are_kept_and_their_place_is_reported(self, staged, ends):
        def refuses(*_):
            raise SessionError("the disk is full")

        with pytest.raises(SessionError, match="the recorder process died; the disk is full") as caught:
            ends(refuses)
        assert f"inteco-abs recover {staged.memory.path} --out FILE" in str(caught.value)
        assert caught.value.exit_code == 5


class TestByHand:
    """Without a recorder, for a screen."""

    @pytest.fixture
    def held(self, staged):
        """Hold the board until `over` has done its part."""

        def run(over, *, drill=False):
            def direct():
                words = staged.words
                if "drill" in staged.children:
                    Staged.direct(staged)
                elif words[Field.GUARDED_PID]:
                    words[Field.READY] = words[Field.HOLDER_PID] = staged.children["loop"].pid

            staged.direct = direct
            with staged.manual_control(drill=drill):
                assert staged._watch.judging
                assert staged.words[Field.UNRECORDED] == 1
                over()
                staged.words[Field.HOLDER_PID] = 0
                staged.kill("loop")

        return run

    @pytest.mark.parametrize("drill", [True, False])
    def test_the_guardian_proves_itself_first_if_it_has_to(self, staged, held, drill):
        held(lambda: None, drill=drill)
        assert (staged.memory.note(Mailbox.DRILL) is not None) == drill
        assert staged.words[Field.OVER] == 1

    @pytest.mark.parametrize(
        ("report", "failure", "image", "error", "words"),
        [
            (RESCUE | {"failure": "no board"}, None, True, UnsafeError, "held the board died, and then: no board"),
            (RESCUE, None, True, BoardError, "died; the guardian has written SAFE and read it back"),
            (RESCUE, None, False, BoardError, "died; nothing had been written"),
            (None, {"kind": "UnsafeError", "text": "on", "notes": []}, True, UnsafeError, "^on$"),
            (None, {"kind": "LinkError", "text": "gone", "notes": []}, True, BoardError, "^gone$"),
            (RESCUE, {"kind": "UnsafeError", "text": "on", "notes": []}, True, UnsafeError, "^on$"),
        ],
    )
    def test_the_boards_end_state_is_raised(self, staged, held, report, failure, image, error, words):
        def over():
            if image:
                staged.memory.post(Mailbox.SAFE_IMAGE, b"all zero")
            if failure:
                staged.memory.post(Mailbox.FAILURE, failure)
            if report:
                staged.memory.post(Mailbox.RESCUE, report)
                staged.words[Field.RESCUED_PID] = staged.children["loop"].pid

        with pytest.raises(error, match=words):
            held(over)


@pytest.mark.parametrize("first", ["guardian", "trips"])
def test_no_process_is_started_before_the_mock_board_is_there(staged, first):
    def comes():
        assert list(staged.children) == ["board"]
        staged.memory.socket.touch()
        del staged.direct
        if first == "trips":
            staged.direct = lambda: staged.memory.post(Mailbox.RESULT, {})

    staged.children["board"] = staged.child()
    staged.direct = comes
    if first == "trips":
        assert staged.ask(first) == {}
    else:
        assert staged.run(staged.screen) == RESULT
    assert list(staged.children)[1] == first


def test_the_guardian_may_end_only_once_the_board_of_a_dead_loop_is_safe(staged, monkeypatch):
    seen, words = [], staged.words

    def wait(condition, _most_s):
        seen.append((words[Field.OVER], condition()))
        words[Field.RESCUED_PID] = words[Field.LOOP_PID]
        seen.append((words[Field.OVER], condition()))

    monkeypatch.setattr(staged.memory, "wait", wait)
    words[Field.LOOP_PID] = words[Field.HOLDER_PID] = 77
    staged.end()
    assert seen == [(0, False), (0, True)]
    assert words[Field.OVER] == 1


def test_a_question_is_answered_by_one_process_that_is_not_guarded(staged):
    staged.direct = lambda: staged.memory.post(Mailbox.RESULT, {"times_us": [1.0]})
    assert staged.ask("trips") == {"times_us": [1.0]}
    assert list(staged.children) == ["trips"]
    assert staged.words[Field.SUPERVISOR_PID] == os.getpid()
    assert staged.children["trips"].poll() is not None
