"""The walk on the mock board, in this process: the simulated rig is under simulated hands."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from typing import Final

from inteco_abs.boards import Board, InProcessLink, board_behind
from inteco_abs.config import RigConfig
from inteco_abs.lab.bench import TURNS, Bench, Wheel
from inteco_abs.lab.devices import Found
from inteco_abs.mock_board import Device, face_of
from inteco_abs.realtime import PacedClock

_TURNING_S: Final = 5.0
"""For ten turns: a quick hand."""


class MockBench(Bench):
    """The mock of the configured board, powered up once for the whole walk; `virtual`: as fast as it goes."""

    def __init__(self, config: RigConfig, *, virtual: bool, seed: int = 0) -> None:
        super().__init__("sim:")
        self._virtual = virtual
        self._virtual_ns = 0
        self.device = Device(config, self.now_ns, seed)
        self._face = face_of(self.device)

    def devices(self, config: RigConfig) -> list[Found]:
        """The mock alone."""
        return [Found("sim:", f"the mock {config.board.kind} board with the simulated rig, in this program")]

    def open(self, config: RigConfig) -> Board:
        """The mock, by direct calls."""
        return board_behind(InProcessLink(self._face), config, self.now_ns)

    def now_ns(self) -> int:
        """Virtual or real time."""
        return self._virtual_ns if self._virtual else time.monotonic_ns()

    def pause(self, seconds: float) -> None:
        """Let the rig move on."""
        if self._virtual:
            self._virtual_ns += round(seconds * 1e9)
        else:
            time.sleep(seconds)

    def beats(self, period_ns: int) -> Iterator[object]:
        """In virtual time without waiting."""
        return self._virtual_beats(period_ns) if self._virtual else iter(PacedClock(period_ns))

    def turned(self, which: Wheel) -> None:
        """A hand turns it, forwards, with the lever lifted."""
        self.device.turn(which, TURNS, _TURNING_S)

    def powered(self, *, on: bool) -> None:
        """Someone has gone to the switch."""
        self.device.power(on=on)

    def _virtual_beats(self, period_ns: int) -> Iterator[object]:
        for beat in itertools.count():
            self._virtual_ns += period_ns
            yield beat
