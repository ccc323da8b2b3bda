"""Faults of the computer: its processes, its clock, and the session's disk."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

from inteco_abs.mock_board.faults.kinds import CLOCK_STEP, PROCESSES
from inteco_abs.mock_board.faults.schedule import Schedule
from inteco_abs.posix import resource


class FaultyHost:
    """Applies the faults of `schedule` to a run's processes and to its session at `file`.

    `pid_of` returns a process id by name, 0 for a missing process. A clock step changes this process's wall clock.
    Leaving the context ends all faults.
    """

    def __init__(self, schedule: Schedule, file: Path, pid_of: Callable[[str], int]) -> None:
        self._schedule = schedule
        self._file = file
        self._pid_of = pid_of
        self._frozen: dict[str, int] = {}
        self._full: tuple[int, tuple[int, int]] | None = None
        """Process whose disk is full, and its limits of the file size before."""
        self._wall_ns = time.time_ns

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        for name in tuple(self._frozen):
            self._thaw(name)
        self._free_disk()
        time.time_ns = self._wall_ns

    def act(self) -> None:
        """Begin and end the faults that are due; call it often."""
        for name in PROCESSES:
            self._kill_or_freeze(name)
        if self._schedule.once("file-gone"):
            self._file.unlink(missing_ok=True)
        if step := self._schedule.once(CLOCK_STEP):
            self._step_clock(round(step.value * 1e9))
        if self._full is None and self._schedule.once("disk-full"):
            self._fill_disk(self._pid_of("recorder"))
        elif self._full is not None and not self._schedule.lasting("disk-full"):
            self._free_disk()

    def frozen(self, name: str) -> bool:
        """Return whether a fault has frozen that process."""
        return name in self._frozen

    def _kill_or_freeze(self, name: str) -> None:
        if self._schedule.once(f"{name}-killed"):
            _send(self._pid_of(name), signal.SIGKILL)
        if self._schedule.once(f"{name}-frozen"):
            self._frozen[name] = self._pid_of(name)
            _send(self._frozen[name], signal.SIGSTOP)
        elif name in self._frozen and not self._schedule.lasting(f"{name}-frozen"):
            self._thaw(name)

    def _thaw(self, name: str) -> None:
        _send(self._frozen.pop(name), signal.SIGCONT)

    def _step_clock(self, step_ns: int) -> None:
        before = time.time_ns
        time.time_ns = lambda: before() + step_ns

    def _fill_disk(self, pid: int) -> None:
        if pid <= 0:  # 0 is the calling process
            return
        with suppress(ProcessLookupError):
            before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, before[1]))
            self._full = pid, before

    def _free_disk(self) -> None:
        if self._full is not None:
            pid, before = self._full
            self._full = None
            with suppress(ProcessLookupError):
                resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


def _send(pid: int, number: int) -> None:
    if pid > 0:  # 0 is the whole process group
        with suppress(ProcessLookupError):
            os.kill(pid, number)
