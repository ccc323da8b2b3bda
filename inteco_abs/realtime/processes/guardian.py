"""The guardian's process: it takes the board and writes SAFE when the process that holds the board dies or hangs.

It cannot help when the computer dies, the cable is pulled, or loop, guardian and supervisor are killed together: no
RT-DAC board is known to switch its outputs off by itself, so only the emergency switch stops the motor then.
"""

from __future__ import annotations

import os
import select
import signal
import time
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from inteco_abs.boards import open_board
from inteco_abs.config import RigConfig
from inteco_abs.errors import BoardError
from inteco_abs.realtime.alarm import Alarm
from inteco_abs.realtime.failure_rules import POLL_NS, POLL_S, SUPERVISOR_WINDOW_NS, Action, Silence, guardian_does
from inteco_abs.realtime.heartbeat import beating
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory, alive
from inteco_abs.realtime.tuning import GUARDIAN_PRIORITY, apply, guardian_tuning, watch_tuning
from inteco_abs.signals import Reason

_RECORDER_WINDOW_NS: Final = 1_000_000_000
_PATIENCE_NS: Final = 3_000_000_000
_TRY_S: Final = 5.0
_AGAIN_S: Final = 0.002


class Guardian:
    """Watches the process that the supervisor names, until the supervisor ends the run."""

    def __init__(self, memory: RunMemory, job: Job) -> None:
        self._memory = memory
        self._job = job
        self._words = memory.words
        self._ticks = memory.tick_reader()
        self._poller = select.poll()
        self._guarded = 0
        self._left = 0  # the process guarded before, which has ended
        self._killed = False
        self._end = -1  # file descriptor that becomes readable when the guarded process ends
        self._loop = Silence(loop_window_ns(job.config))
        self._patience = Silence(_PATIENCE_NS)
        self._supervisor = Silence(SUPERVISOR_WINDOW_NS)
        self._recorder = Silence(_RECORDER_WINDOW_NS)
        self._alarm = Alarm(memory, turn=1)
        self._before_ns = time.monotonic_ns()

    def watch(self) -> None:
        """Watch and act until nothing is left to guard."""
        while not self.over():
            ended = bool(self._poller.poll(POLL_NS / 1e6))
            self.look(time.monotonic_ns(), ended=ended)

    def look(self, now_ns: int, *, ended: bool) -> None:
        """Beat, look at the others, act; `ended`: the guarded process is gone."""
        passed_ns, self._before_ns = now_ns - self._before_ns, now_ns
        self._words[Field.GUARDIAN_BEAT_NS] = now_ns
        silent = self._hangs(passed_ns) or self._goes_on_after_stop(passed_ns)
        held = self._words[Field.HOLDER_PID] == self._guarded != 0
        action = guardian_does(held=held, loop_ended=ended, loop_silent=silent)
        if Action.KILL_LOOP in action:
            self._kill()
        if ended:
            self._leave(rescue=Action.RESCUE in action)
        self._check_the_others(passed_ns)
        self._alarm.look()
        self._follow()

    def over(self) -> bool:
        """Whether nothing is left to guard; if the supervisor is gone, processes that still wait are stopped."""
        words = self._words
        left_alone = not alive(words[Field.SUPERVISOR_PID]) and not self._guarded
        if left_alone and not words[Field.GUARDIAN_STOP]:
            words[Field.GUARDIAN_STOP] = Reason.SUPERVISOR_LOST
        return bool(words[Field.OVER]) or left_alone

    def _follow(self) -> None:
        """Guard the process that the supervisor names now."""
        pid = self._words[Field.GUARDED_PID]
        if self._guarded or pid in (0, self._left):
            return
        with suppress(ProcessLookupError):  # it has ended without opening the board
            self._end = os.pidfd_open(pid)
            self._poller.register(self._end, select.POLLIN)
            self._guarded, self._killed = pid, False
            self._words[Field.GUARDING_PID] = pid

    def _hangs(self, passed_ns: int) -> bool:
        """Return whether the guarded process drives and has completed no tick for too long."""
        if not self._guarded or self._words[Field.HOLDER_PID] != self._guarded or not self._ticks.written:
            self._loop.forget()
            return False
        return self._loop.lasts(self._ticks.written, passed_ns)

    def _goes_on_after_stop(self, passed_ns: int) -> bool:
        """Return whether the guarded process still runs long after the guardian has stopped the run."""
        if not self._guarded or not self._words[Field.GUARDIAN_STOP]:
            return False
        return self._patience.lasts(0, passed_ns)

    def _kill(self) -> None:
        """Kill the guarded process. Its board is taken only after its end: two hosts must not write to it."""
        self._killed = True
        kill(self._end)

    def _leave(self, *, rescue: bool) -> None:
        """Stop guarding a process that has ended; take over its board if it held one."""
        pid, self._guarded = self._guarded, 0
        self._poller.unregister(self._end)
        os.close(self._end)
        if rescue:
            with ExitStack() as stack:
                # no thread left: the supervisor may consider this process hung, and replace it
                with suppress(BoardError):
                    beat = beating(self._memory, Field.GUARDIAN_BEAT_NS, POLL_S, watch_tuning(GUARDIAN_PRIORITY))
                    stack.enter_context(beat)
                take_over(self._memory, self._job, pid, "hung" if self._killed else "died", "guardian")
        self._left = pid

    def _check_the_others(self, passed_ns: int) -> None:
        """End the run if the supervisor or the recorder is lost."""
        words = self._words
        if words[Field.GUARDIAN_STOP]:
            return
        if self._gone(Field.SUPERVISOR_PID) or self._supervisor.lasts(words[Field.SUPERVISOR_BEAT_NS], passed_ns):
            words[Field.GUARDIAN_STOP] = Reason.SUPERVISOR_LOST
        elif not words[Field.GO]:
            return
        elif self._gone(Field.RECORDER_PID) or self._recorder.lasts(words[Field.RECORDER_BEAT_NS], passed_ns):
            words[Field.GUARDIAN_STOP] = Reason.RECORDER_LOST

    def _gone(self, word: Field) -> bool:
        return not alive(self._words[word])


def kill(process: int) -> None:
    """Kill the process of a pidfd, never another that has its number now."""
    with suppress(ProcessLookupError):
        signal.pidfd_send_signal(process, signal.SIGKILL)


def loop_window_ns(config: RigConfig) -> int:
    """Return how long a driving loop may be silent, ns."""
    return max(round(config.guard.silence_s * 1e9), 5 * config.period_ns)


def take_over(memory: RunMemory, job: Job, pid: int, cause: str, by: str) -> None:
    """Make the board of the dead process `pid` safe, and post the result."""
    seen_ns = time.monotonic_ns()
    failure = _make_safe(memory, job)
    report = {"cause": cause, "seen_ns": seen_ns, "done_ns": time.monotonic_ns(), "failure": failure, "by": by}
    memory.post(Mailbox.RESCUE, report)
    memory.words[Field.RESCUED_PID] = pid


def _make_safe(memory: RunMemory, job: Job) -> str:
    """Write SAFE and read it back, for up to 5 s; return an empty text, or why it failed."""
    end = time.monotonic() + _TRY_S
    while True:
        try:
            rescue(memory, job)
        except Exception as error:  # noqa: BLE001  the kernel may still hold the board; nothing may end this
            if time.monotonic() > end:
                return str(error)
            time.sleep(_AGAIN_S)
        else:
            return ""


def rescue(memory: RunMemory, job: Job) -> None:
    """Open the board of a dead process and write the SAFE image that it posted; raises BoardError."""
    image = memory.image(Mailbox.SAFE_IMAGE)
    if image is None:
        return  # it had not finished opening the board, so only zero duties were written
    # motors may be on: no time to compare engines
    usb = replace(job.config.usb, engine="one-by-one")
    open_board(job.address, replace(job.config, usb=usb), time.monotonic_ns).rescue(image)


def main(path: str) -> int:
    """Guard the run in the memory at `path`."""
    memory = RunMemory.open(Path(path))
    guardian = Guardian(memory, Job.of(memory))
    apply(guardian_tuning())
    guardian.watch()
    return 0
