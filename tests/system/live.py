"""A real-time run seen from outside: its processes by name, its shared memory, its end."""

import json
import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

from inteco_abs.realtime.memory import FOLDER, Field, RunMemory
from inteco_abs.sessions import read_session

QUICK = (
    "experiment.start_speed_rad_s=40.0",
    "experiment.idle_s=0.02",
    "experiment.hold_s=0.1",
    "guard.silence_s=0.2",
)
"""About two seconds of turning wheels, and a window of the guardian in which a shared computer does not pause."""

STARTS = 3
TOO_BUSY = "set loop.rate_hz to", "ended before the run began", "guardian does not watch", "did not answer within"
"""Message of a run that does not begin because the board, or a process, does not answer in time."""


class LiveRun:
    """`inteco-abs run` in real time, from the moment at which its loop may begin."""

    def __init__(self, command, folder, environment, *arguments, settings=QUICK, begun=True, **options):
        self.out = folder / "stop.mcap"
        sets = [word for setting in settings for word in ("--set", setting)]
        words = [command, "run", "--board", "sim:", "--out", self.out, "--json", *sets, *arguments]
        for attempt in range(STARTS):
            before = set(FOLDER.glob("*.ring"))
            self.process = subprocess.Popen(
                words, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                start_new_session=True, **options,
            )  # fmt: skip
            self.memory = self._find(before)
            self.words = self.memory.words
            self.ticks = self.memory.tick_reader()
            if not begun or self._begins(last=attempt == STARTS - 1):
                break

    def _begins(self, *, last):
        """Whether the loop may go; if not, because this computer was too busy for the rate just now."""
        try:
            self.until(lambda: self.words[Field.GO])
        except AssertionError as error:
            if last or not any(text in str(error) for text in TOO_BUSY):
                raise
            return False
        return True

    def _find(self, before):
        end = time.monotonic() + 60.0
        while time.monotonic() < end and self.process.poll() is None:
            for path in set(FOLDER.glob("*.ring")) - before:
                try:
                    memory = RunMemory.open(path)
                except Exception:  # noqa: BLE001, S112  just being made; the loop ends in time
                    continue
                if ancestor(memory.words[Field.SUPERVISOR_PID], self.process.pid):
                    return memory
            time.sleep(0.002)
        raise AssertionError(f"no run began: {self.process.communicate()}")

    def until(self, condition, most_s=60.0):
        end = time.monotonic() + most_s
        while not condition():
            if self.process.poll() is not None or time.monotonic() > end:
                raise AssertionError(f"it never came to that: {self.process.communicate()}")
            time.sleep(0.001)

    def until_tick(self, number):
        self.until(lambda: self.ticks.written >= number)

    def pid(self, role):
        """Number of the process of a role: `supervisor`, `loop`, `recorder`, `guardian` or `board`."""
        known = {"supervisor": Field.SUPERVISOR_PID, "loop": Field.LOOP_PID, "recorder": Field.RECORDER_PID}
        if role in known:
            return self.words[known[role]]
        end = time.monotonic() + 10.0
        while time.monotonic() < end:
            pid = self.child(role)
            if pid:
                return pid
        raise AssertionError(f"no {role}")

    def child(self, role):
        """Pid of `loop`, `recorder`, `guardian` or `board`; 0 if there is none, not yet or not any more."""
        wanted = {"board": "inteco_abs.mock_board_process"}.get(role, role).encode()
        for entry in Path("/proc").iterdir():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if wanted in words and str(self.memory.path).encode() in words:
                return int(entry.name)
        return 0

    def kill(self, role, number=signal.SIGKILL):
        """Send a signal; the time, in ns of the monotonic clock, just before."""
        pid = self.pid(role)
        now_ns = time.monotonic_ns()
        os.kill(pid, number)
        return now_ns

    def end(self, most_s=60.0):
        """Waits for the command; its exit code, card (None if it printed none) and messages."""
        stdout, stderr = self.process.communicate(timeout=most_s)
        assert "Traceback" not in stderr, stderr
        return self.process.returncode, json.loads(stdout) if stdout else None, stderr

    def session(self):
        return read_session(self.out)

    def destroy(self):
        """Kill all that is left of the run, also what is frozen, and remove its memory."""
        for number in (signal.SIGCONT, signal.SIGKILL):
            for pid in self.processes():
                with suppress(ProcessLookupError):  # it may end meanwhile
                    os.kill(pid, number)
        self.process.kill()
        self.process.communicate()
        self.memory.remove()

    def processes(self):
        """Everything that still runs for this run."""
        path = str(self.memory.path).encode()
        found = []
        for entry in Path("/proc").iterdir():
            try:
                if path in (entry / "cmdline").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
            except OSError:
                continue
        return found


def ancestor(pid, wanted):
    """Whether `wanted` is `pid` or one of those that started it."""
    while pid > 1:
        if pid == wanted:
            return True
        try:
            pid = int((Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            return False
    return False


def safe_after_ns(session, then_ns):
    """Time from `then_ns` until the board's own record shows both outputs off for good, in ns."""
    truth = session.truth
    on = (truth["drive"] > 0.0) | (truth["brake"] > 0.0)
    last_on = int(truth["time_ns"][on][-1]) if on.any() else 0
    off = truth["time_ns"][truth["time_ns"] > last_on]
    assert len(off), "the board was left with an output on"
    return max(0, int(off[0]) - then_ns)
