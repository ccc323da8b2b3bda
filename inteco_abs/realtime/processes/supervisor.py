"""The supervisor: it starts the processes of a run, drills the guardian, starts the loop, and reports the result.

It is the process that the user started, and the only one that handles the user's signals.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from inteco_abs import errors
from inteco_abs.errors import AbsError, BoardError, SessionError, UnsafeError, on_one_line
from inteco_abs.realtime.alarm import Alarm
from inteco_abs.realtime.disk_watch import DiskWatch
from inteco_abs.realtime.foxglove_server import address
from inteco_abs.realtime.heartbeat import NO_MORE
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.process_watch import ProcessWatch
from inteco_abs.realtime.processes import ENTRY
from inteco_abs.realtime.processes.recorder import describe_board, rebuild, run_end
from inteco_abs.realtime.screen import NoScreen, SafeScreen, Screen, Snapshot, SnapshotSource, StartCheck
from inteco_abs.realtime.signal_handlers import handle_signals
from inteco_abs.realtime.tuning import apply, supervisor_tuning
from inteco_abs.sessions import EXIT_CODES, LOSSES, RunResult, spill_path
from inteco_abs.signals import EXPLANATIONS, Reason

_POLL_S: Final = 0.01
_START_S: Final = 60.0
_WATCHES_S: Final = 15.0
_DRILL_S: Final = 8.0
"""Longer than the guardian tries to rescue."""
_RESCUE_S: Final = 20.0
"""The guardian tries for 5 s, and the watch after that."""
_FINISH_S: Final = 30.0
_END_S: Final = 3.0
_PATIENCE_S: Final = 2.0
"""Time for a loop to end or to begin."""
_SAVING_S: Final = 30.0
"""Time for the loop's process to write the capture of a long run, with its board safe."""
_MANUAL: Final = ("manual", "loop")
"""Role and name of the process in the loop's place."""


class Supervisor:
    """One real-time run in `memory`, whose job was posted."""

    def __init__(self, memory: RunMemory, job: Job) -> None:
        self._memory = memory
        self._job = job
        self._words = memory.words
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._ticks = memory.tick_reader()
        self._snapshots = SnapshotSource(memory.tick_reader(), memory.histogram, job.config.loop.rate_hz)
        self._alive_s = 0.0
        self._watch: ProcessWatch | None = None
        self._watching = ExitStack()

    def run(self, screen: Screen, tuning: AbstractContextManager[None] | None = None) -> RunResult:
        """Run the job, in the context `tuning` from the first tick on.

        Raises what kept it from starting; KeyboardInterrupt if the operator stopped it before.
        """
        screen = SafeScreen(screen)
        allowed = os.sched_getaffinity(0)
        with handle_signals(self._stop), screen.listening(self._stop):
            try:
                self._start()
                watch = self._begin_watch()
                self._drill(screen)
                self._start_loop(screen, watch)
                with tuning or nullcontext():
                    self._until_the_loop_ends(screen, watch)
                return self._result()
            finally:
                self.end()
                os.sched_setaffinity(0, allowed)

    def ask(self, role: str) -> Any:
        """Run the process of one role alone and unguarded; return the note RESULT that it posts."""
        try:
            self._await_the_mock()
            self.spawn(role, ENTRY, role, str(self._memory.path))
            self._wait_for(lambda: self._memory.note(Mailbox.RESULT) is not None, "the answer comes", role, _START_S)
            return self._memory.note(Mailbox.RESULT)
        finally:
            self.end()

    @contextmanager
    def manual_control(self, *, drill: bool) -> Iterator[None]:
        """Hold the board for a screen inside the context, in a guarded process; nothing is recorded.

        With `drill` the guardian has to prove itself first, as before a run. Raises what kept the board from being
        opened or ended the process; UnsafeError if SAFE was not confirmed.
        """
        words = self._words
        words[Field.UNRECORDED] = 1
        with handle_signals(self._stop):
            try:
                self._await_the_mock()
                for role, name in (("guardian", "guardian"), *((("drill", "drill"),) if drill else ()), _MANUAL):
                    self.spawn(name, ENTRY, role, str(self._memory.path))
                loop = self._children["loop"]
                self._memory.name(Field.LOOP_PID, loop.pid)
                watch = self._begin_watch()
                if drill:
                    self._drill(NoScreen())
                words[Field.GUARDED_PID] = loop.pid
                self._wait_for(lambda: words[Field.READY] == loop.pid, "the board opens", "loop", _START_S)
                watch.judging = True
                yield
            finally:
                self.end()
                self._require_safe()
        self._raise_failure()

    def _rescued(self) -> Any:
        """Return the report on the rescue of the held board; None without one."""
        words = self._words
        return self._memory.note(Mailbox.RESCUE) if words[Field.RESCUED_PID] == words[Field.LOOP_PID] != 0 else None

    def _require_safe(self) -> None:
        """Raise UnsafeError if SAFE was not confirmed in the end."""
        report, failure = self._rescued(), self._memory.note(Mailbox.FAILURE)
        if report is not None and report["failure"]:
            raise UnsafeError(f"the process that held the board {report['cause']}, and then: {report['failure']}")
        if report is None and failure is not None and failure["kind"] == UnsafeError.__name__:
            raise restored_error(failure)

    def _raise_failure(self) -> None:
        """Raise the last error of the process that held the board, or that it has died."""
        report, failure = self._rescued(), self._memory.note(Mailbox.FAILURE)
        if failure is not None:
            raise restored_error(failure)
        if report is not None:
            written = self._memory.image(Mailbox.SAFE_IMAGE) is not None
            then = f"the {report['by']} has written SAFE and read it back" if written else "nothing had been written"
            raise BoardError(f"the process that held the board {report['cause']}; {then}")

    def spawn(self, name: str, module: str, *arguments: str) -> None:
        """Start a process of the run. Raises BoardError if the system refuses it."""
        try:
            self._children[name] = subprocess.Popen(  # noqa: S603  our own modules
                # -P: a signal.py in the user's folder must not replace the standard one
                [sys.executable, "-P", "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=_stderr(),  # what a controller prints must not mix with the result card
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
                start_new_session=True,  # Ctrl-C and a closed terminal reach the supervisor only
            )
        except OSError as error:
            why = error.strerror or error
            raise BoardError(f"the {name} process cannot be started: {why}; {NO_MORE}") from error

    def _stop(self) -> None:
        """Stop the run for the operator; the first reason stays."""
        self._words[Field.STOP] = self._words[Field.STOP] or Reason.OPERATOR_STOP

    def _await_the_mock(self) -> None:
        if "board" in self._children:
            self._wait_for(self._memory.socket.exists, "the mock board is there", "board", _START_S)

    def _start(self) -> None:
        self._await_the_mock()
        for role in ("guardian", "recorder", "drill", "loop"):
            self.spawn(role, ENTRY, role, str(self._memory.path))
        self._memory.name(Field.LOOP_PID, self._children["loop"].pid)

    def _begin_watch(self) -> ProcessWatch:
        """Start the watch in its own thread, as drawing a screen may block."""
        watch = ProcessWatch(self._memory, self._job, self._children["loop"].pid, self._children["guardian"].pid)
        self._watching.enter_context(watch.watching())
        self._watch = watch
        return watch

    def _drill(self, screen: Screen) -> None:
        """Kill a process that holds the board, and require that the guardian takes over, before the loop may start."""
        words, drill = self._words, self._children["drill"]
        words[Field.GUARDED_PID] = drill.pid
        self._wait_for(lambda: words[Field.GUARDING_PID] == drill.pid, "the guardian watches", "guardian", _WATCHES_S)
        self._wait_for(lambda: words[Field.READY] == drill.pid, "the board opens", "drill", _START_S)
        if self._memory.image(Mailbox.SAFE_IMAGE) is None:
            raise BoardError("the drill posted no SAFE image; nothing was started")
        screen.passed(StartCheck.BOARD, self._job.board)
        drill.kill()
        killed_ns = time.monotonic_ns()
        self._children.pop("drill").wait()
        self._wait_for(lambda: words[Field.RESCUED_PID] == drill.pid, "the guardian takes over", "guardian", _DRILL_S)
        report = self._memory.note(Mailbox.RESCUE)
        if report["failure"]:
            raise UnsafeError(f"the guardian failed its drill, so nothing was started: {report['failure']}")
        took_ms = (report["done_ns"] - killed_ns) * 1e-6
        detail = f"SAFE {took_ms:.1f} ms after the kill"
        self._memory.post(Mailbox.DRILL, {"guardian drill": detail})
        screen.passed(StartCheck.GUARDIAN, detail)

    def _start_loop(self, screen: Screen, watch: ProcessWatch) -> None:
        words, loop = self._words, self._children["loop"]
        words[Field.GUARDED_PID] = loop.pid
        self._wait_for(lambda: words[Field.READY] == loop.pid, "the loop is ready", "loop", _START_S)
        self._wait_for(lambda: words[Field.RECORDING], "the recorder is ready", "recorder", _START_S)
        screen.passed(StartCheck.RECORDER, self._job.session)
        if words[Field.LIVE_PORT]:
            screen.note(f"live view: open the connection {address(words[Field.LIVE_PORT])} in Lichtblick or Foxglove")
        settings = self._memory.note(Mailbox.HEADER)["settings"]
        refused = [setting["name"] for setting in settings if setting["refused"]]
        if refused:
            screen.note(
                f"ticks will be late more often: the system refused {', '.join(refused)}; see inteco-abs doctor"
            )
        apply(supervisor_tuning())  # not before: the processes would inherit it
        watch.judging = True
        words[Field.GO] = 1

    def _wait_for(self, condition: Callable[[], object], what: str, who: str, most_s: float) -> None:
        end = time.monotonic() + most_s
        while not condition():
            if self._words[Field.STOP]:
                raise KeyboardInterrupt
            for name, child in self._children.items():
                if child.poll() is not None:
                    raise self._failure_of(name)
            if time.monotonic() > end:
                raise BoardError(f"{what}: not within {most_s:g} s, waiting for the {who} process; nothing was started")
            time.sleep(_POLL_S / 10)

    def _failure_of(self, name: str) -> AbsError:
        """Return the error that a process posted before it ended."""
        note = Mailbox.RECORDER_FAILURE if name == "recorder" else Mailbox.FAILURE
        failure = self._memory.note(note)
        if failure is None:
            ended = f"the {name} process ended before the run began (exit code {self._children[name].returncode})"
            reason = Reason(self._words[Field.GUARDIAN_STOP])
            why = f": {EXPLANATIONS[reason]}" if reason else ""
            return BoardError(f"{ended}{why}; nothing was started")
        return restored_error(failure)

    def _until_the_loop_ends(self, screen: SafeScreen, watch: ProcessWatch) -> None:
        loop = self._children["loop"]
        disk = DiskWatch(self._memory, self._job)
        alarm = Alarm(self._memory, turn=0, say=screen.shown)
        shown = 0.0
        self._alive_s = time.monotonic()
        while loop.poll() is None:
            watch.main_ns = time.monotonic_ns()
            if self._children["recorder"].poll() is not None and not self._words[Field.STOP]:
                self._words[Field.STOP] = Reason.RECORDER_LOST
            alarm.look()
            disk.look(screen)
            self._kill_overdue_loop()
            if time.monotonic() - shown >= screen.period_s:
                self._show(screen)
                shown = time.monotonic()
            time.sleep(_POLL_S)
        watch.main_ns = None
        self._show(screen)  # how it ended
        if watch.failure:
            ended = self._words[Field.GUARDIAN_STOP] == Reason.SUPERVISOR_LOST
            end = "; the guardian ended the run" if ended else ""
            screen.warn(f"the supervisor's watching thread failed: {watch.failure}{end}")
        failure = self._memory.note(Mailbox.FAILURE)
        if failure is not None and failure["kind"] == UnsafeError.__name__:
            screen.warn(failure["text"])  # now: the guardian may still try for seconds

    def _kill_overdue_loop(self) -> None:
        """Kill a loop that is still there long after a stop, after it closed the board, or without having begun.

        Its threads, its exit or a signal may block it; the guardian makes the board safe if the loop still held it.
        """
        words = self._words
        if words[Field.HOLDER_PID] and self._ticks.written and not (words[Field.STOP] or words[Field.GUARDIAN_STOP]):
            self._alive_s = time.monotonic()
        elif time.monotonic() - self._alive_s > (_SAVING_S if words[Field.SAVING] else _PATIENCE_S):
            self._children["loop"].kill()

    def _show(self, screen: Screen) -> None:
        snapshot = self.snapshot()
        if snapshot is not None:
            screen.show(snapshot)

    def snapshot(self) -> Snapshot | None:
        """The newest tick, what came since the last look, and the timing so far; None before the first."""
        return self._snapshots.look()

    def _result(self) -> RunResult:
        """Return the result from the recorder, or, if that is gone, from the session that this process rebuilds."""
        self._await_the_rescue()
        recorder, memory = self._children["recorder"], self._memory
        silent = self._words[Field.GUARDIAN_STOP] == Reason.RECORDER_LOST
        _gone_within(recorder, _END_S if silent else _FINISH_S)
        result = memory.note(Mailbox.RESULT)
        if result is not None:
            return RunResult(**result | {"reason": Reason(result["reason"]), "not_made": tuple(result["not_made"])})
        failure = memory.note(Mailbox.RECORDER_FAILURE)
        if recorder.poll() is None:
            recorder.kill()
            recorder.wait()
        rebuilt = self._rebuild(failure["text"] if failure else "")
        if rebuilt is None:
            failure = failure or memory.note(Mailbox.FAILURE)
            if failure is None and memory.words[Field.STOP] == Reason.OPERATOR_STOP:
                raise KeyboardInterrupt  # the recorder had nothing to record, and ended
            why = EXPLANATIONS[Reason(memory.words[Field.GUARDIAN_STOP] or memory.words[Field.STOP])]
            raise restored_error(failure) if failure else SessionError(f"the run ended before its first tick: {why}")
        return rebuilt

    def _rebuild(self, failure: str) -> RunResult | None:
        """Make the session from memory, at its path or else at the spill path; None if there was no tick.

        `failure` is the recorder's error, empty if it died. Raises SessionError if neither disk takes it.
        """
        job, memory = self._job, self._memory
        spill = spill_path(job.path, job.config, job.session_id)
        refused = [failure or "the recorder process died"]
        for place, session in ((job.path, Path(job.session)), (spill, spill)):
            if place is None:
                continue
            try:
                result = rebuild(memory, job, place, session)
            except AbsError as error:
                refused.append(on_one_line(error))
                continue
            if result is None or (len(refused) == 1 and not failure):
                return result
            refused += filter(None, [result.trouble])
            return replace(result, trouble=f"{'; '.join(refused)}; the whole session is in {session}")
        trouble = SessionError(
            f"{describe_board(memory)}, but {'; '.join(refused)}. "
            f"The ticks are kept in {memory.path}: inteco-abs recover {memory.path} --out FILE"
        )
        trouble.exit_code = EXIT_CODES.get(run_end(memory).outcome, LOSSES)
        raise trouble

    def _await_the_rescue(self) -> None:
        """Wait until the board of a dead holder is safe, or cannot be made so."""
        words = self._words
        pid = words[Field.LOOP_PID]
        self._memory.wait(
            lambda: not pid or words[Field.HOLDER_PID] != pid or words[Field.RESCUED_PID] == pid, _RESCUE_S
        )

    def end(self) -> None:
        """End all processes, with the board safe. May be called again."""
        words = self._words
        loop = self._children.get("loop")
        if self._watch is not None:
            self._watch.judging = True
        if loop is not None and loop.poll() is None:
            self._stop()
            if not _gone_within(loop, _END_S):
                loop.kill()  # the guardian makes the board safe
                loop.wait()
        self._await_the_rescue()  # before the guardian ends
        for name in ("drill", "recorder"):
            child = self._children.get(name)
            if child is not None and not _gone_within(child, _END_S):
                child.kill()
        words[Field.OVER] = 1
        for child in self._children.values():
            if not _gone_within(child, _END_S):
                child.kill()
            child.wait()
        self._watching.close()


def _stderr() -> int:
    try:
        return sys.stderr.fileno()
    except (OSError, ValueError, AttributeError):  # closed, or a notebook's
        return subprocess.DEVNULL


def restored_error(note: Mapping[str, Any]) -> AbsError:
    """Return another process's error with its own class and notes."""
    kind = getattr(errors, note["kind"], None)
    if isinstance(kind, type) and issubclass(kind, AbsError) and kind is not errors.ConfigError:
        error: AbsError = kind(note["text"])
    else:
        error = BoardError(note["text"])
    for text in note["notes"]:
        error.add_note(text)
    return error


def _gone_within(child: subprocess.Popen[bytes], most_s: float) -> bool:
    with suppress(subprocess.TimeoutExpired):
        child.wait(most_s)
    return child.returncode is not None
