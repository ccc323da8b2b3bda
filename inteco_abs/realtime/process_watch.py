"""Watches loop and guardian for the supervisor, in a thread that no screen can block: software's last resort."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from inteco_abs.errors import describe_error
from inteco_abs.realtime.alarm import Alarm
from inteco_abs.realtime.failure_rules import GUARDIAN_WINDOW_NS, POLL_S, Action, Silence, supervisor_does
from inteco_abs.realtime.heartbeat import repeating
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, RunMemory, has_ended
from inteco_abs.realtime.processes.guardian import kill, loop_window_ns, take_over
from inteco_abs.realtime.tuning import watch_tuning
from inteco_abs.signals import Reason

_MAIN_WINDOW_NS: Final = 1_000_000_000
"""A main thread that is silent for so long does not react to its user any more."""
_RESCUE_NS: Final = 8_000_000_000
"""Longer than the guardian tries to rescue."""


class ProcessWatch:
    """Beats for the supervisor, and replaces a lost guardian. Each `look` is short, unless it rescues."""

    def __init__(self, memory: RunMemory, job: Job, loop_pid: int, guardian_pid: int) -> None:
        self.judging = False
        """Whether loop and guardian must both be alive now."""
        self.main_ns: int | None = None
        """Monotonic time of the main thread's last round; None where it may block."""
        self.failure = ""
        """What ended the watching thread; empty while it runs."""
        self._memory, self._job, self._words = memory, job, memory.words
        self._ticks = memory.tick_reader()
        self._loop_pid = loop_pid
        self._loop, self._guardian = os.pidfd_open(loop_pid), os.pidfd_open(guardian_pid)
        self._loop_silence = Silence(loop_window_ns(job.config))
        self._guardian_silence = Silence(GUARDIAN_WINDOW_NS)
        self._rescue_silence = Silence(_RESCUE_NS)
        self._killed = False
        self._alarm = Alarm(memory, turn=2)
        self._before_ns = time.monotonic_ns()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Look every 5 ms inside the context. Raises BoardError if no thread can be started."""
        try:
            with repeating(self._look_or_report, POLL_S, watch_tuning()):
                yield
        finally:
            os.close(self._loop)
            os.close(self._guardian)

    def _look_or_report(self) -> None:
        try:
            self.look()
        except Exception as error:
            self.failure = describe_error(error)
            raise  # ends the thread and its beat, so the guardian ends the run

    def look(self) -> None:
        """Beat, check the others, act."""
        now_ns = time.monotonic_ns()
        passed_ns, self._before_ns = now_ns - self._before_ns, now_ns
        if self.main_ns is None or now_ns - self.main_ns <= _MAIN_WINDOW_NS:
            self._words[Field.SUPERVISOR_BEAT_NS] = now_ns
        if self.judging:
            self._do(self._decide(passed_ns))
            self._alarm.look()

    def _decide(self, passed_ns: int) -> Action:
        words = self._words
        loop_ended = has_ended(self._loop)
        held = words[Field.HOLDER_PID] == self._loop_pid != words[Field.RESCUED_PID]
        written = self._ticks.written
        if not held or not written:
            self._loop_silence.forget()
        if not held or not loop_ended:
            self._rescue_silence.forget()
        silent = self._guardian_silence.lasts(words[Field.GUARDIAN_BEAT_NS], passed_ns)
        return supervisor_does(
            held=held,
            loop_ended=loop_ended,
            loop_silent=self._loop_silence.lasts(written, passed_ns),
            guardian_ended=has_ended(self._guardian),
            guardian_silent=silent or self._rescue_silence.lasts(0, passed_ns),
        )

    def _do(self, action: Action) -> None:
        if Action.STOP in action:
            self._words[Field.STOP] = self._words[Field.STOP] or Reason.GUARDIAN_LOST
        if Action.KILL_GUARDIAN in action:
            kill(self._guardian)
        if Action.KILL_LOOP in action and not has_ended(self._loop):
            self._killed = True
            kill(self._loop)
        if Action.RESCUE in action:
            take_over(self._memory, self._job, self._loop_pid, "hung" if self._killed else "died", "supervisor")
