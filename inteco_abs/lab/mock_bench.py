"""The walk on the mock board, in this process: the simulated rig is under simulated hands."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Final

from inteco_abs.boards import Board, InProcessLink, Link, board_behind
from inteco_abs.config import RigConfig
from inteco_abs.lab.bench import TURNS, Bench, Wheel
from inteco_abs.lab.devices import Found
from inteco_abs.mock_board import Device, face_of

_TURNING_S: Final = 5.0
"""For ten turns: a quick hand."""


class MockBench(Bench):
    """The mock of the configured board, powered up once for the whole walk.

    Its time is virtual, so that a busy computer is never late; unless `virtual`, it is also never ahead of real time.
    """

    def __init__(self, config: RigConfig, *, virtual: bool, seed: int = 0) -> None:
        super().__init__("sim:")
        self._paced = not virtual
        self._due_s = 0.0
        self._now_ns = 0
        self.device = Device(config, self.now_ns, seed)
        self._face = face_of(self.device)

    def devices(self, config: RigConfig) -> list[Found]:
        """The mock alone."""
        return [Found("sim:", f"the mock {config.board.kind} board with the simulated rig, in this program")]

    def open(self, config: RigConfig) -> Board:
        """The mock, by direct calls."""
        return board_behind(self.link(), config, self.now_ns)

    def link(self) -> Link:
        """A new host's end of the cable."""
        return InProcessLink(self._face)

    def now_ns(self) -> int:
        """Virtual time."""
        return self._now_ns

    def pause(self, seconds: float) -> None:
        """Let the rig move on."""
        self._now_ns += round(seconds * 1e9)
        if self._paced:
            now_s = time.monotonic()
            self._due_s = max(self._due_s + seconds, now_s)  # what took longer is not made up for
            time.sleep(self._due_s - now_s)

    def beats(self, period_ns: int) -> Iterator[object]:
        """One pause each."""
        for beat in itertools.count():
            self.pause(period_ns * 1e-9)
            yield beat

    def turned(self, which: Wheel) -> None:
        """A hand turns it, forwards, with the lever lifted."""
        self.device.turn(which, TURNS, _TURNING_S)

    def powered(self, *, on: bool) -> None:
        """Someone has gone to the switch."""
        self.device.power(on=on)
