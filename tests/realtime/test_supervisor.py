import os
import signal
from types import SimpleNamespace

import pytest

from inteco_abs import errors
from inteco_abs.errors import (
    AbsError,
    AnswerError,
    BoardError,
    CaptureError,
    CommissioningError,
    ConfigError,
    ConfigIssue,
    ControllerError,
    LinkError,
    NoAnswerError,
    ReadOnlyError,
    Stopped,
    UnsafeError,
)
from inteco_abs.errors import SessionError as SessionTrouble
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.realtime.ownership import post_failure
from inteco_abs.realtime.processes import supervisor as supervisor_module
from inteco_abs.realtime.processes.supervisor import Supervisor, restored_error
from inteco_abs.realtime.screen import Lines, NoScreen, Point, SafeScreen, Snapshot
from inteco_abs.sessions import TICK, pack_tick
from inteco_abs.signals import BoardFlags, Phase, Reason, Tick

KINDS = (
    AbsError,
    AnswerError,
    BoardError,
    LinkError,
    NoAnswerError,
    UnsafeError,
    ReadOnlyError,
    SessionTrouble,
    CaptureError,
    ControllerError,
    CommissioningError,
    Stopped,
)


class TestRaisedAgain:
    @pytest.mark.parametrize("kind", KINDS)
    @pytest.mark.parametrize("notes", [[], ["first", "second"]])
    def test_an_error_of_another_process_keeps_its_class_its_text_and_its_notes(self, memory, kind, notes):
        error = kind("the board µ is gone\nfor good")
        for note in notes:
            error.add_note(note)
        post_failure(memory, Mailbox.FAILURE, error)
        again = restored_error(memory.note(Mailbox.FAILURE))
        assert type(again) is kind
        assert str(again) == str(error)
        assert again.exit_code == error.exit_code
        assert getattr(again, "__notes__", []) == notes

    def test_every_class_of_errors_is_tested_here(self):
        ours = {value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, AbsError)}
        assert ours == {*KINDS, ConfigError, errors.ArgumentError}  # the last is raised by calls, not by processes

    @pytest.mark.parametrize("kind", ["ValueError", "Mistake", "near_match", "Path", "__name__", "", "no such thing"])
    def test_a_foreign_error_becomes_a_board_error(self, kind):
        again = restored_error({"kind": kind, "text": "what happened", "notes": ["where"]})
        assert type(again) is BoardError
        assert (str(again), again.__notes__) == ("what happened", ["where"])

    def test_a_mistake_in_the_configuration_keeps_its_text(self, memory):
        error = ConfigError([ConfigIssue("controller.name", "cannot be made"), ConfigIssue("board", "is missing")])
        post_failure(memory, Mailbox.FAILURE, error)
        again = restored_error(memory.note(Mailbox.FAILURE))
        assert isinstance(again, AbsError)
        assert str(again) == str(error)


FIRST_NS = 7_000_000_000


def tick(number, **values):
    made = Tick(
        FIRST_NS + number * 500_000, number, 0.0005, 3 * number, 2 * number, BoardFlags.NONE, Reason.NONE,
        10.0 + number, 20.0 + number, 0.125, True, Phase.SPIN_UP, 0.2, 0.0, 0.0, 0.9, 0.1, 0.75, 0.25, Reason.NONE,
        0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 0,
    )  # fmt: skip
    return made._replace(**values)


@pytest.fixture
def supervisor(memory, job_of):
    return Supervisor(memory, job_of(memory))


@pytest.fixture
def ring(memory):
    return memory.tick_ring(pack_tick)


class TestSnapshot:
    def test_a_supervisor_names_itself_at_once(self, supervisor, memory):
        assert supervisor is not None
        assert memory.words[Field.SUPERVISOR_PID] == os.getpid()

    def test_before_the_first_tick_there_is_no_snapshot(self, supervisor):
        assert supervisor.snapshot() is None

    def test_snapshot_has_the_values_of_the_newest_tick(self, supervisor, ring, memory):
        for number in range(5):
            ring.append(tick(number))
        ring.append(tick(5, phase=Phase.BRAKING, slip=0.5))
        memory.histogram.add([1.0, 2.0, 30.0], skipped=4)
        first = Point(FIRST_NS, 10.0, 20.0, 0.125, Phase.SPIN_UP, 0.2, 0.0, 0.75, 0.25)
        assert supervisor.snapshot() == Snapshot(
            Phase.BRAKING, 6, 2_500_000 * 1e-9, 15.0, 25.0, 0.5, 0.75, 0.25, 4, (3.0, 30.0, 30.0, 30.0), (first,)
        )

    def test_snapshot_has_200_points_a_second_since_the_previous_one(self, supervisor, ring):
        seen = []
        for number in range(45):
            ring.append(tick(number))
            if number % 7 == 0 or number == 44:
                seen += supervisor.snapshot().recent
        assert [point.wheel_speed_rad_s - 10.0 for point in seen] == [0.0, 10.0, 20.0, 30.0, 40.0]
        assert [point.time_ns - FIRST_NS for point in seen] == [number * 500_000 for number in range(0, 45, 10)]

    def test_time_counts_from_the_first_tick_however_late_it_looks(self, supervisor, ring):
        ring.append(tick(0))
        ring.append(tick(1, time_ns=FIRST_NS + 500_000_000))
        assert supervisor.snapshot().time_s == 0.5
        ring.append(tick(2, time_ns=FIRST_NS + 1_250_000_000))
        assert supervisor.snapshot().time_s == 1.25

    def test_before_the_recorder_has_counted_nothing_is_known_of_the_lateness(self, supervisor, ring):
        ring.append(tick(0))
        shown = supervisor.snapshot()
        assert shown.overruns == 0
        assert shown.late_us[:3] == (None, None, None)

    def test_looking_takes_nothing_from_the_recorder(self, supervisor, ring, memory):
        for number in range(3):
            ring.append(tick(number))
            supervisor.snapshot()
        assert TICK.array(memory.tick_reader().take())["tick"].tolist() == [0, 1, 2]

    def test_what_the_recorder_has_taken_can_still_be_looked_at(self, supervisor, ring, memory):
        ring.append(tick(0))
        memory.tick_reader().take()
        assert supervisor.snapshot().ticks == 1

    @pytest.mark.parametrize("phase", Phase)
    def test_every_phase_can_be_shown(self, supervisor, ring, phase):
        ring.append(tick(0, phase=phase))
        assert supervisor.snapshot().phase is phase


def test_no_key_of_the_users_terminal_reaches_the_processes_that_it_starts(supervisor):
    supervisor.spawn("drill", "code")
    pid = supervisor._children["drill"].pid
    assert os.getsid(pid) == pid
    supervisor.end()


class TestDrill:
    """Before every run a process that holds the board is killed, and what becomes of it decides."""

    @pytest.fixture
    def staged(self, memory, job_of, child, monkeypatch):
        """A supervisor whose processes only sleep; words and notes that the drill posts decide the end."""
        for name, most_s in (("_END_S", 0.0), ("_DRILL_S", 0.1), ("_START_S", 0.1)):
            monkeypatch.setattr(supervisor_module, name, most_s)

        class Staged(Supervisor):
            def spawn(self, name, *_words):
                self._children[name] = process = child()
                if name == "drill":
                    memory.words[Field.GUARDING_PID] = memory.words[Field.READY] = process.pid
                    memory.words[Field.RESCUED_PID] = process.pid if memory.note(Mailbox.RESCUE) else 0

        return Staged(memory, job_of(memory))

    @pytest.mark.parametrize(
        ("image", "failure", "refusal"),
        [
            (b"all zero", "no board", "failed its drill, so nothing was started: no board"),
            (b"all zero", None, "the guardian takes over: not within"),
            (None, "", "the drill posted no SAFE image"),
        ],
        ids=["SAFE was not confirmed", "no process took over", "there is no image"],
    )
    def test_without_a_passed_guardian_drill_the_loop_does_not_open_the_board(
        self, memory, staged, image, failure, refusal
    ):
        if image is not None:
            memory.post(Mailbox.SAFE_IMAGE, image)
        if failure is not None:
            memory.post(Mailbox.RESCUE, {"failure": failure, "done_ns": 0})
        with pytest.raises(BoardError, match=refusal):
            staged.run(NoScreen())
        assert memory.words[Field.GO] == 0
        assert memory.words[Field.GUARDED_PID] != memory.words[Field.LOOP_PID] != 0


class TestALoopWithoutEnd:
    @pytest.mark.parametrize(
        "words", [{}, {Field.HOLDER_PID: 1, Field.STOP: Reason.OPERATOR_STOP}], ids=["let go", "header to stop"]
    )
    def test_a_loop_that_should_have_ended_long_ago_is_killed(self, memory, job_of, child, monkeypatch, words):
        """A thread, an exit handler or a signal may keep it; the guardian is not concerned, as it has let go."""
        monkeypatch.setattr(supervisor_module, "_PATIENCE_S", 0.05)
        memory.tick_ring(pack_tick).append(tick(0))
        for word, value in words.items():
            memory.words[word] = value
        supervisor = Supervisor(memory, job_of(memory))
        loop = supervisor._children["loop"] = child("sleep", "10")
        supervisor._children["recorder"] = child()
        supervisor._until_the_loop_ends(SafeScreen(NoScreen()), SimpleNamespace(main_ns=None, failure=""))
        assert loop.returncode == -signal.SIGKILL

    @pytest.mark.parametrize(
        ("stop", "end"), [(Reason.SUPERVISOR_LOST, "; the guardian ended the run"), (Reason.NONE, "")]
    )
    def test_the_error_that_ended_the_watching_thread_is_reported(self, memory, job_of, child, stop, end):
        supervisor, said = Supervisor(memory, job_of(memory)), []
        supervisor._children |= {"loop": child("true"), "recorder": child()}
        memory.words[Field.GUARDIAN_STOP] = stop
        watch = SimpleNamespace(main_ns=None, failure="OSError: no descriptor")
        supervisor._until_the_loop_ends(SafeScreen(Lines(said.append)), watch)
        assert said == [f"the supervisor's watching thread failed: OSError: no descriptor{end}"]
