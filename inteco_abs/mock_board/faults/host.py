"""Faults of the computer: of its processes, and of the disk for the session."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from inteco_abs.mock_board.faults.kinds import CLOCK_STEP, PROCESSES
from inteco_abs.mock_board.faults.schedule import Schedule

_NOTHING_MORE: Final = 0
"""Bytes to which a file may grow."""


class FaultyHost:
    """Applies the faults of `schedule` to a run's processes and to its session at `file`.

    `pid_of` returns a process by name, 0 for a missing one. The wall clock that steps is this process's. Leaving the
    context ends all faults.
    """

    def __init__(self, schedule: Schedule, file: Path, pid_of: Callable[[str], int]) -> None:
        self._schedule = schedule
        self._file = file
        self._pid_of = pid_of
        self._frozen: dict[str, int] = {}
        self._full: tuple[int, tuple[int, int]] | None = None
        """Process whose disk is full, and how long its files may be otherwise."""
        self._wall_ns = time.time_ns
        """The computer's own."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        for name in tuple(self._frozen):
            self._thaw(name)
        self._give_room()
        time.time_ns = self._wall_ns

    def act(self) -> None:
        """Begin and end the faults that are due; call it often."""
        for name in PROCESSES:
            self._do_to(name)
        if self._schedule.once("file-gone"):
            self._file.unlink(missing_ok=True)
        if step := self._schedule.once(CLOCK_STEP):
            self._step_clock(round(step.value * 1e9))
        if self._full is None and self._schedule.once("disk-full"):
            self._take_room(self._pid_of("recorder"))
        elif self._full is not None and not self._schedule.lasting("disk-full"):
            self._give_room()

    def frozen(self, name: str) -> bool:
        """Return whether that process is frozen by a fault."""
        return name in self._frozen

    def _do_to(self, name: str) -> None:
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

    def _take_room(self, pid: int) -> None:
        if pid <= 0:  # 0 would be ourselves
            return
        with suppress(ProcessLookupError):
            before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (_NOTHING_MORE, before[1]))
            self._full = pid, before

    def _give_room(self) -> None:
        if self._full is not None:
            pid, before = self._full
            self._full = None
            with suppress(ProcessLookupError):
                resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


def _send(pid: int, number: int) -> None:
    if pid > 0:  # 0 would be everybody
        with suppress(ProcessLookupError):
            os.kill(pid, number)
