"""The firmware in an emulator: tools/emulated_board as a process, and what its board's outputs did."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

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


class Change(NamedTuple):
    """The outputs from an instant of the board's clock on."""

    clock_us: int
    widths: tuple[int, int]


class EmulatedBoard:
    """A running emulated board at the serial port `link`; its emulator has the number `pid`."""

    def __init__(self, folder: Path, chip: str, *options: str) -> None:
        self.link = folder / "board"
        self._record = folder / "outputs.jsonl"
        command = [sys.executable, ROOT / "tools" / "emulated_board", "--chip", chip, *options]
        command += ["--link", self.link, "--record", self._record]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        ready = self.process.stdout.readline()
        assert "the emulator is process" in ready
        self.pid = int(ready.split("process ")[1].split(";")[0])

    def changes(self) -> list[Change]:
        """What its outputs did so far."""
        lines = self._record.read_text(encoding="utf-8").splitlines()
        return [Change(each["clock_us"], tuple(each["widths"])) for each in map(json.loads, lines)]

    def unplug(self) -> None:
        """Hang its line up."""
        self.process.send_signal(signal.SIGUSR1)

    def end(self) -> None:
        self.process.terminate()
        self.process.wait(10)
        self.process.stdout.close()


@contextmanager
def emulated_board(folder: Path, chip: str = "mps2", *options: str) -> Iterator[EmulatedBoard]:
    """Run an emulated board with its files in `folder`."""
    require(*NEEDED[chip])
    board = EmulatedBoard(folder, chip, *options)
    try:
        yield board
    finally:
        board.end()
