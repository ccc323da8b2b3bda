"""The supervisor's watch over loop and guardian, look by look, with real processes to kill."""

import os
import resource
import signal
import threading
from types import SimpleNamespace

import pytest

from inteco_abs.boards import STILL_ON
from inteco_abs.realtime import alarm as alarm_module
from inteco_abs.realtime import process_watch as watch_module
from inteco_abs.realtime.alarm import Alarm
from inteco_abs.realtime.failure_rules import GUARDIAN_WINDOW_NS, POLL_NS, POLL_S
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.realtime.process_watch import ProcessWatch
from inteco_abs.realtime.processes import guardian as guardian_module
from inteco_abs.sessions import pack_tick
from inteco_abs.signals import UNTIMED, BoardFlags, Phase, Reason, Tick

MS = 1_000_000
TICK_OF_NOTHING = Tick(
    0, 0, 0.0005, 0, 0, BoardFlags.NONE, Reason.NONE, 0.0, 0.0, 0.0, False, Phase.IDLE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
    0.0, Reason.NONE, 0.0, 0.0, 0.0, 0.0, *UNTIMED,
)  # fmt: skip


class Scene:
    """A loop that holds the board and a guardian, both mere processes, watched in a time of their own."""

    def __init__(self, memory, job, child, until):
        self.memory, self.words = memory, memory.words
        self.loop, self.guardian = child(), child()
        self.now_ns = 10**12
        self.rescued = []
        self._until = until
        self._ring = memory.tick_ring(pack_tick)
        self.words[Field.LOOP_PID] = self.words[Field.HOLDER_PID] = self.loop.pid
        self.tick()
        self.watch = ProcessWatch(memory, job, self.loop.pid, self.guardian.pid)
        self.watch.judging = True

    def tick(self):
        self._ring.append(TICK_OF_NOTHING)

    def look(self, most_ms, *, guardian_beats=False, loop_ticks=False, until=lambda: False):
        """Look every 5 ms until the time is over or `until` holds; return the time taken, ms."""
        for passed in range(0, most_ms, POLL_NS // MS):
            if until():
                return passed
            self.now_ns += POLL_NS
            if guardian_beats:
                self.words[Field.GUARDIAN_BEAT_NS] = self.now_ns
            if loop_ticks:
                self.tick()
            self.watch.look()
        return most_ms

    def kill(self, process):
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)

    def has_ended(self, process):
        """A kill takes the kernel some time, in which the watch does not run."""
        self._until(lambda: process.poll() is not None, "it ends")


@pytest.fixture
def memory(new_memory):
    return new_memory(ticks=1000)


@pytest.fixture
def scene(memory, job_of, child, until, monkeypatch):
    job = job_of(memory, "guard.silence_s=0.05")
    clock = SimpleNamespace(monotonic_ns=lambda: made.now_ns if made else 10**12)
    made = None
    for module in (watch_module, alarm_module):
        monkeypatch.setattr(module, "time", clock)
    made = Scene(memory, job, child, until)
    monkeypatch.setattr(guardian_module, "rescue", lambda memory, _job: made.rescued.append(memory))
    return made


def test_while_both_are_there_nothing_is_done_but_to_beat(scene):
    scene.look(2000, guardian_beats=True, loop_ticks=True)
    assert scene.words[Field.SUPERVISOR_BEAT_NS] == scene.now_ns
    assert scene.words[Field.STOP] == 0
    assert scene.loop.poll() is scene.guardian.poll() is None


def test_a_guardian_that_dies_has_the_loop_stopped_at_the_next_look(scene):
    scene.look(100, guardian_beats=True, loop_ticks=True)
    scene.kill(scene.guardian)
    scene.look(5, guardian_beats=True, loop_ticks=True)
    assert scene.words[Field.STOP] == Reason.GUARDIAN_LOST
    assert scene.loop.poll() is None


def test_a_frozen_guardian_has_the_loop_stopped_once_its_window_is_over(scene):
    scene.look(100, guardian_beats=True, loop_ticks=True)
    took_ms = scene.look(1000, loop_ticks=True, until=lambda: scene.words[Field.STOP])
    assert GUARDIAN_WINDOW_NS / MS < took_ms <= GUARDIAN_WINDOW_NS / MS + 10
    assert scene.loop.poll() is None  # it still runs, so that it can receive the stop


def test_more_than_a_thousand_descriptors_are_not_an_obstacle(scene, memory, job_of):
    limits, taken = resource.getrlimit(resource.RLIMIT_NOFILE), []
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(limits[1], 4096), limits[1]))
    try:
        while not taken or taken[-1] < 1024:
            taken.append(os.dup(0))
        scene.watch = ProcessWatch(memory, job_of(memory), scene.loop.pid, scene.guardian.pid)
        scene.watch.judging = True
        scene.kill(scene.guardian)
        scene.look(5, guardian_beats=True, loop_ticks=True)
    finally:
        for file in taken:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert scene.words[Field.STOP] == Reason.GUARDIAN_LOST


def test_the_first_reason_stays(scene):
    scene.words[Field.STOP] = Reason.OPERATOR_STOP
    scene.kill(scene.guardian)
    scene.look(100, loop_ticks=True)
    assert scene.words[Field.STOP] == Reason.OPERATOR_STOP


@pytest.mark.parametrize("loop", ["killed", "frozen"])
@pytest.mark.parametrize("guardian", ["killed", "frozen"])
def test_board_is_taken_over_once_loop_and_guardian_have_ended(scene, loop, guardian):
    scene.look(100, guardian_beats=True, loop_ticks=True)
    for process, how in ((scene.loop, loop), (scene.guardian, guardian)):
        if how == "killed":
            scene.kill(process)
        else:
            process.send_signal(signal.SIGSTOP)
    took_ms = scene.look(200)
    for process in (scene.loop, scene.guardian):
        assert process.wait(30) == -signal.SIGKILL
    scene.look(10)
    assert took_ms <= 200
    assert scene.rescued == [scene.memory]
    assert scene.words[Field.RESCUED_PID] == scene.loop.pid
    report = scene.memory.note(Mailbox.RESCUE)
    assert (report["by"], report["failure"]) == ("supervisor", "")
    assert report["cause"] == ("died" if loop == "killed" else "hung")
    scene.look(1000)
    assert scene.rescued == [scene.memory]


def test_nothing_is_written_while_one_that_was_killed_has_not_ended(scene, monkeypatch):
    monkeypatch.setattr(signal, "pidfd_send_signal", lambda *_: None)
    scene.kill(scene.guardian)
    scene.look(2000)
    assert scene.rescued == []
    scene.kill(scene.loop)
    scene.look(10)
    assert scene.rescued == [scene.memory]


def test_a_guardian_that_beats_is_left_to_its_work(scene):
    scene.kill(scene.loop)
    scene.look(5000, guardian_beats=True)
    assert scene.guardian.poll() is None
    assert scene.rescued == []


def test_one_that_beats_but_does_not_come_to_an_end_is_relieved(scene):
    scene.kill(scene.loop)
    scene.look(8100, guardian_beats=True)
    assert scene.guardian.wait(30) == -signal.SIGKILL
    scene.look(10)
    assert scene.rescued == [scene.memory]


def test_a_loop_that_released_its_board_needs_no_rescue(scene):
    scene.words[Field.HOLDER_PID] = 0
    for process in (scene.loop, scene.guardian):
        scene.kill(process)
    scene.look(1000)
    assert scene.rescued == []
    assert scene.words[Field.STOP] == 0


def test_loop_silent_before_it_held_the_board_does_not_count_as_hung(scene, monkeypatch):
    killed = []
    monkeypatch.setattr(signal, "pidfd_send_signal", lambda *_: killed.append(1))
    scene.words[Field.HOLDER_PID] = 0
    scene.look(1000, guardian_beats=True)
    scene.words[Field.HOLDER_PID] = scene.loop.pid
    scene.kill(scene.guardian)
    scene.look(5)
    assert scene.words[Field.STOP] == Reason.GUARDIAN_LOST
    assert killed == []


def test_the_guardian_ends_nothing_while_the_loop_lives(scene):
    scene.look(9000, guardian_beats=True)
    assert scene.words[Field.STOP] == 0


def test_a_frozen_loop_is_reported_by_the_supervisor_too(scene, until, capfd):
    scene.look(600, guardian_beats=True)
    until(lambda: scene.words[Field.ALARMED], "it is said")
    assert STILL_ON in capfd.readouterr().err


def test_it_beats_by_itself_while_it_watches_and_leaves_no_descriptor_open(scene, job_of, until, monkeypatch):
    opened, pidfd_open = [], os.pidfd_open
    monkeypatch.setattr(os, "pidfd_open", lambda pid: opened.append(pidfd_open(pid)) or opened[-1])
    watch = ProcessWatch(scene.memory, job_of(scene.memory), scene.loop.pid, scene.guardian.pid)
    assert round(POLL_S * 1e9) == POLL_NS
    with watch.watching():
        until(lambda: scene.words[Field.SUPERVISOR_BEAT_NS] == scene.now_ns, "it beats")
    assert len(opened) == 2
    for descriptor in opened:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(descriptor)


def test_before_the_run_has_begun_no_process_is_judged(scene, job_of):
    scene.watch = ProcessWatch(scene.memory, job_of(scene.memory), scene.loop.pid, scene.guardian.pid)
    scene.look(2000)
    assert scene.words[Field.STOP] == 0
    assert scene.words[Field.SUPERVISOR_BEAT_NS] == scene.now_ns


def test_after_a_stall_of_the_computer_every_window_starts_over(scene):
    scene.look(100, guardian_beats=True, loop_ticks=True)
    scene.now_ns += 10**10
    scene.look(100)
    assert scene.words[Field.STOP] == 0


def test_a_main_thread_that_does_not_come_round_takes_the_beat_away(scene):
    scene.watch.main_ns = scene.now_ns
    scene.look(2000, guardian_beats=True, loop_ticks=True)
    assert scene.words[Field.SUPERVISOR_BEAT_NS] == scene.watch.main_ns + 1000 * MS


class TestAlarm:
    @pytest.fixture
    def said(self):
        return []

    @pytest.fixture
    def look(self, scene, said):
        """Looks of a process in its turn for some ms; it can warn or not."""

        def make(turn=0, *, able=True):
            alarm = Alarm(scene.memory, turn, lambda text: said.append(text) or able)

            def look(most_ms):
                for passed in range(0, most_ms, 5):
                    scene.now_ns += POLL_NS
                    alarm.look()
                    if said:
                        return passed + 5
                return most_ms

            return look

        return make

    @pytest.mark.parametrize("turn", range(4))
    def test_processes_report_a_silence_of_300_ms_one_after_another(self, look, said, turn):
        assert 300 + 100 * turn < look(turn)(2000) <= 310 + 100 * turn
        (text,) = said
        assert STILL_ON in text

    def test_silence_from_before_the_board_was_held_does_not_count(self, scene, look):
        watch = look()
        watch(200)
        scene.words[Field.HOLDER_PID] = 0
        watch(1000)
        scene.words[Field.HOLDER_PID] = scene.loop.pid
        assert watch(2000) > 300

    def test_it_is_reported_once_and_by_one_process(self, scene, look, said):
        look(0)(500)
        look(1)(5000)
        for _ in range(3):
            look(0)(1000)
        assert len(said) == 1
        assert scene.words[Field.ALARMED] == 1

    def test_a_watcher_that_cannot_warn_leaves_the_warning_to_the_next(self, look, said):
        unable = look(0, able=False)
        for _ in range(3):
            unable(500)
        assert len(said) == 1
        said.clear()
        look(1)(1000)
        assert len(said) == 1

    @pytest.mark.parametrize(
        ("loop", "holder", "rescued"),
        [(True, False, False), (True, True, True), (False, False, True)],
        ids=["let go", "rescued", "no loop yet"],
    )
    def test_a_safe_board_is_not_reported(self, scene, look, said, loop, holder, rescued):
        scene.words[Field.LOOP_PID] = loop * scene.loop.pid
        scene.words[Field.HOLDER_PID] = holder * scene.loop.pid
        scene.words[Field.RESCUED_PID] = rescued * scene.loop.pid
        look()(5000)
        assert said == []

    @pytest.fixture
    def warn(self, scene):
        """Look until the terminal has to be warned."""

        def warn():
            alarm = Alarm(scene.memory, turn=1)
            for _ in range(100):
                scene.now_ns += POLL_NS
                alarm.look()

        return warn

    def test_the_terminal_is_warned_where_no_screen_draws(self, scene, warn, until, capfd):
        warn()
        until(lambda: scene.words[Field.ALARMED] == 1, "it is said")
        assert STILL_ON in capfd.readouterr().err

    def test_a_halted_terminal_blocks_no_process_not_even_at_the_end(self, scene, warn, monkeypatch):
        before, over = threading.enumerate(), threading.Event()
        monkeypatch.setattr(alarm_module, "os", SimpleNamespace(write=lambda *_: over.wait(30)))
        warn()
        (writer,) = (thread for thread in threading.enumerate() if thread not in before)
        assert writer.daemon
        assert scene.words[Field.ALARMED] == 0
        over.set()
        writer.join()


def test_what_ends_the_watching_thread_is_kept_for_the_user(scene, monkeypatch):
    monkeypatch.setattr(scene.watch, "look", lambda: os.close(-1))
    with pytest.raises(OSError, match="descriptor"):
        scene.watch._look_or_report()
    assert "descriptor" in scene.watch.failure
