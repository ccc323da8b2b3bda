"""What the guardian does at each look, in a time of its own, with real processes to kill."""

import os
import signal
from types import SimpleNamespace

import pytest

from inteco_abs.boards import STILL_ON
from inteco_abs.realtime import alarm as alarm_module
from inteco_abs.realtime.failure_rules import POLL_NS, SUPERVISOR_WINDOW_NS
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.realtime.processes import guardian as guardian_module
from inteco_abs.realtime.processes.guardian import Guardian
from inteco_abs.sessions import TICK, pack_tick
from inteco_abs.signals import Reason

MS = 1_000_000
BEATS = {Field.SUPERVISOR_BEAT_NS, Field.RECORDER_BEAT_NS}


class Scene:
    """A process that is guarded and holds the board, and others; all are mere processes."""

    def __init__(self, memory, new_guardian, child):
        self.memory, self.words = memory, memory.words
        self.process, self.supervisor = child(), child()
        self.now_ns = 10**12
        self.rescued = []
        self.words[Field.SUPERVISOR_PID] = self.supervisor.pid
        self.words[Field.RECORDER_PID] = os.getpid()
        self.words[Field.LOOP_PID] = self.words[Field.HOLDER_PID] = self.process.pid
        self._ring = memory.tick_ring(pack_tick)
        self._new_guardian = new_guardian
        self.ended = False

    def guard(self, *settings):
        """Begin, with these settings."""
        self.guardian = self._new_guardian(self, settings)
        self.words[Field.GUARDED_PID] = self.process.pid
        self.look(5)
        assert self.words[Field.GUARDING_PID] == self.process.pid
        return self

    def tick(self):
        self._ring.append([0] * len(TICK.columns))

    def look(self, most_ms, *, beating=BEATS, ticking=False, until=lambda: False):
        """Look every 5 ms until the time is over or `until` holds; return the time taken, ms."""
        for passed in range(0, most_ms, POLL_NS // MS):
            if until() or self.guardian.over():
                return passed
            self.now_ns += POLL_NS
            for word in beating:
                self.words[word] += 1
            if ticking:
                self.tick()
            self.guardian.look(self.now_ns, ended=self.ended)
            self.ended = False
        return most_ms

    def kill(self, process):
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        self.ended = self.ended or process is self.process

    def killed_within(self, most_ms, **how):
        """How long the process lives, ms; all of them if it outlives them."""
        return self.look(most_ms, until=lambda: self.killed, **how)


@pytest.fixture
def memory(new_memory):
    return new_memory(ticks=1000)


@pytest.fixture
def scene(memory, job_of, child, monkeypatch):
    def begun(made, settings):
        clock = SimpleNamespace(monotonic_ns=lambda: made.now_ns, monotonic=lambda: made.now_ns * 1e-9)
        for module in (guardian_module, alarm_module):
            monkeypatch.setattr(module, "time", clock)
        made.killed = False
        kill = guardian_module.kill

        def noted(process):
            made.killed = True
            kill(process)

        monkeypatch.setattr(guardian_module, "kill", noted)
        monkeypatch.setattr(guardian_module, "rescue", lambda memory, _job: made.rescued.append(memory))
        return Guardian(memory, job_of(memory, *settings))

    return Scene(memory, begun, child)


class TestHang:
    @pytest.mark.parametrize(
        ("settings", "window_ms"),
        [
            (("guard.silence_s=0.05",), 50),
            (("guard.silence_s=0.3",), 300),
            (("guard.silence_s=0.05", "loop.rate_hz=50.0", "estimator.window_s=0.1"), 100),
        ],
        ids=["fast loop", "longer window", "five periods of a slow loop"],
    )
    def test_a_silent_owner_is_killed_and_its_board_made_safe(self, scene, settings, window_ms):
        scene.guard(*settings)
        assert scene.killed_within(1000, ticking=True) == 1000
        assert window_ms < scene.killed_within(1000) <= window_ms + 5
        assert scene.process.wait(30) == -signal.SIGKILL
        assert scene.rescued == []  # two hosts must not write to it
        scene.ended = True
        scene.look(5)
        assert scene.rescued == [scene.memory]
        report = scene.memory.note(Mailbox.RESCUE)
        assert report == {
            "cause": "hung", "seen_ns": scene.now_ns, "done_ns": scene.now_ns, "failure": "", "by": "guardian",
        }  # fmt: skip
        assert scene.words[Field.RESCUED_PID] == scene.process.pid

    def test_process_before_its_first_tick_has_no_time_limit(self, scene):
        assert scene.guard().killed_within(10_000) == 10_000

    def test_a_loop_that_no_longer_holds_the_board_may_be_silent(self, scene):
        scene.guard().tick()
        scene.words[Field.HOLDER_PID] = 0
        assert scene.killed_within(10_000) == 10_000

    def test_silence_from_before_the_board_was_held_does_not_count(self, scene):
        scene.guard("guard.silence_s=0.05").tick()
        scene.look(40)
        scene.words[Field.HOLDER_PID] = 0
        scene.look(40)
        scene.words[Field.HOLDER_PID] = scene.process.pid
        assert scene.killed_within(1000) > 50

    def test_a_process_that_still_runs_long_after_a_stop_is_killed(self, scene):
        scene.guard()
        scene.words[Field.GUARDIAN_STOP] = Reason.SUPERVISOR_LOST
        assert 3000 < scene.killed_within(5000, ticking=True) <= 3005

    def test_what_is_not_guarded_is_not_waited_for_either(self, scene):
        scene.guard()
        scene.kill(scene.process)
        scene.words[Field.GUARDIAN_STOP] = Reason.RECORDER_LOST
        assert scene.killed_within(5000) == 5000

    def test_a_held_board_without_ticks_is_reported_in_the_second_turn(self, scene, until, capfd):
        scene.guard("guard.silence_s=2.0").tick()
        scene.look(400)
        assert scene.words[Field.ALARMED] == 0
        scene.look(20)
        until(lambda: scene.words[Field.ALARMED], "it is said")
        assert STILL_ON in capfd.readouterr().err


class TestDeath:
    def test_board_of_a_dead_process_is_made_safe_and_the_next_guarded(self, scene, child):
        scene.guard()
        scene.kill(scene.process)
        scene.look(5)
        assert scene.rescued == [scene.memory]
        assert scene.memory.note(Mailbox.RESCUE)["cause"] == "died"
        scene.look(100)  # its number is not guarded again
        assert scene.words[Field.GUARDING_PID] == scene.process.pid
        other = child()
        scene.words[Field.GUARDED_PID] = scene.words[Field.HOLDER_PID] = other.pid
        scene.look(5)
        assert scene.words[Field.GUARDING_PID] == other.pid
        assert not scene.killed

    def test_process_without_a_board_needs_no_rescue(self, scene):
        scene.guard()
        scene.words[Field.HOLDER_PID] = 0
        scene.kill(scene.process)
        scene.look(5)
        assert scene.rescued == []
        assert scene.words[Field.RESCUED_PID] == 0

    def test_death_of_the_process_after_a_hung_one_is_reported_as_a_death(self, scene, child):
        scene.guard("guard.silence_s=0.05").tick()
        scene.killed_within(1000)
        scene.ended = True
        scene.look(5)
        scene.process = child()
        scene.words[Field.GUARDED_PID] = scene.words[Field.HOLDER_PID] = scene.process.pid
        scene.look(5)
        scene.kill(scene.process)
        scene.look(5)
        assert scene.memory.note(Mailbox.RESCUE)["cause"] == "died"

    def test_while_it_is_guarded_no_other_is(self, scene, child):
        scene.guard()
        scene.words[Field.GUARDED_PID] = child().pid
        scene.look(100)
        assert scene.words[Field.GUARDING_PID] == scene.process.pid


class TestTheOthers:
    def test_while_all_are_there_it_beats_and_asks_for_nothing(self, scene):
        scene.guard()
        scene.words[Field.GO] = 1
        assert scene.look(5000, ticking=False) == 5000
        assert scene.words[Field.GUARDIAN_BEAT_NS] == scene.now_ns
        assert scene.words[Field.GUARDIAN_STOP] == 0

    def test_a_supervisor_that_is_gone_ends_the_run_at_once(self, scene):
        scene.guard()
        scene.kill(scene.supervisor)
        scene.look(5)
        assert scene.words[Field.GUARDIAN_STOP] == Reason.SUPERVISOR_LOST

    @pytest.mark.parametrize(
        ("silent", "reason", "window_ms"),
        [
            (Field.SUPERVISOR_BEAT_NS, Reason.SUPERVISOR_LOST, SUPERVISOR_WINDOW_NS // MS),
            (Field.RECORDER_BEAT_NS, Reason.RECORDER_LOST, 1000),
        ],
        ids=["supervisor", "recorder"],
    )
    def test_a_silent_process_ends_the_run(self, scene, silent, reason, window_ms):
        scene.guard()
        scene.words[Field.GO] = 1
        scene.look(50)
        took_ms = scene.look(5000, beating=BEATS - {silent}, until=lambda: scene.words[Field.GUARDIAN_STOP])
        assert scene.words[Field.GUARDIAN_STOP] == reason
        assert window_ms < took_ms <= window_ms + 10

    def test_a_recorder_that_is_gone_ends_a_run_that_has_begun(self, scene, ended):
        scene.words[Field.RECORDER_PID] = ended
        scene.guard().look(2000)
        assert scene.words[Field.GUARDIAN_STOP] == 0
        scene.words[Field.GO] = 1
        scene.look(5)
        assert scene.words[Field.GUARDIAN_STOP] == Reason.RECORDER_LOST

    def test_the_first_reason_stays(self, scene):
        scene.guard()
        scene.words[Field.GUARDIAN_STOP] = Reason.RECORDER_LOST
        scene.kill(scene.supervisor)
        scene.look(100)
        assert scene.words[Field.GUARDIAN_STOP] == Reason.RECORDER_LOST

    def test_left_alone_it_continues_until_nothing_is_left_to_guard(self, scene):
        scene.guard()
        scene.kill(scene.supervisor)
        assert scene.look(2000, ticking=False) == 2000
        scene.kill(scene.process)
        assert scene.look(100) == 5
        assert scene.rescued == [scene.memory]

    def test_the_word_that_all_is_over_ends_it_and_touches_nothing(self, scene):
        scene.guard()
        scene.words[Field.OVER] = 1
        assert scene.look(100) == 0
        assert scene.process.poll() is None
        assert scene.rescued == []
