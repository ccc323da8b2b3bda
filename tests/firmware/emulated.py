"""The firmware in an emulator: tools/emulated_board as a process, and what its board's outputs did."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import pytest

from inteco_abs.realtime import LOOP_PRIORITY

ROOT = Path(__file__).parent.parent.parent
NEEDED = {
    "mps2": ("arm-none-eabi-gcc", "make", "qemu-system-arm"),
    "rp2040": ("arm-none-eabi-gcc", "make", "node"),
}
NPM = ROOT / "firmware" / "hal" / "rp2040" / "emulator" / "node_modules"


def require(*programs):
    """Skip without these programs; fail in CI, where tools/check has installed them."""
    missing = [each for each in programs if shutil.which(each) is None]
    if "node" in programs and not NPM.exists():
        missing.append(str(NPM))
    if missing and os.environ.get("CI"):
        pytest.fail(f"missing: {', '.join(missing)}")
    if missing:
        pytest.skip(f"missing: {', '.join(missing)}")


AT_ONCE_US = 200
"""Between two steps of the firmware the emulator's time goes on, also while the computer does something else."""


class Change(NamedTuple):
    """The outputs from an instant of the board's clock on, and when the two newest ticks began."""

    clock_us: int
    widths: tuple[int, int]
    ticks_us: tuple[int, int]


class EmulatedBoard:
    """A running emulated board at the serial port `link`; its emulator has the number `pid`."""

    def __init__(self, folder: Path, chip: str, *options: str) -> None:
        self.link = folder / "board"
        record = folder / "outputs.jsonl"
        command = [sys.executable, ROOT / "tools" / "emulated_board", "--chip", chip, *options]
        command += ["--link", self.link, "--record", record]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        ready = self.process.stdout.readline()
        assert "the emulator is process" in ready
        self._record = record.open(encoding="utf-8")
        self._begun = ""  # of a line that is being written
        self._changes: list[Change] = []
        self.pid = int(ready.split("process ")[1].split(";")[0])

    def changes(self) -> list[Change]:
        """What its outputs did so far."""
        *lines, self._begun = (self._begun + self._record.read()).split("\n")
        for line in lines:
            found = json.loads(line)
            self._changes.append(Change(found["clock_us"], tuple(found["widths"]), tuple(found["ticks_us"])))
        return self._changes

    def wait_until_off(self, since: int = 0, at_most_s: float = 20.0) -> None:
        """Wait until a change after the first `since` ones has left the outputs off."""
        end = time.monotonic() + at_most_s
        while len(changes := self.changes()) <= since or changes[-1].widths != (0, 0):
            assert time.monotonic() < end, changes[-1]
            time.sleep(0.002)

    def unplug(self) -> None:
        """Hang its line up."""
        self.process.send_signal(signal.SIGUSR1)

    def end(self) -> None:
        self.process.terminate()
        self.process.wait(10)
        self.process.stdout.close()
        self._record.close()


def let_go_at_the_first_tick(last: Change, off: Change, watchdog_us: int, *, at_ticks: bool = False) -> bool:
    """Whether the outputs went off in the first tick after the watchdog's time from the last command on.

    That command made the change `last`, at once, or if `at_ticks` at the tick after it came. On a busy computer the
    emulator's ticks are late, take long, and some are missing: then the time is longer than by one period.
    """
    came_us = last.ticks_us[0] if at_ticks else last.clock_us
    before, tick = off.ticks_us
    in_time = before <= last.clock_us + watchdog_us + AT_ONCE_US
    return in_time and tick <= off.clock_us and came_us + watchdog_us <= off.clock_us + AT_ONCE_US


@contextmanager
def punctual() -> Iterator[None]:
    """Give this process the priority of a run's loop, where the system allows it."""
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LOOP_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def emulated_board(folder: Path, chip: str = "mps2", *options: str) -> Iterator[EmulatedBoard]:
    """Run an emulated board with its files in `folder`."""
    require(*NEEDED[chip])
    board = EmulatedBoard(folder, chip, *options)
    try:
        yield board
    finally:
        board.end()
