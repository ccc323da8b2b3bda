"""Access to the mock board, whose simulated rig has simulated hands."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from inteco_abs.boards import Board, InProcessLink, Link, board_behind
from inteco_abs.commissioning.rig_access import TURNS, Hold, RigAccess, Wheel
from inteco_abs.config import RigConfig
from inteco_abs.format import TICK
from inteco_abs.host import FoundBoard
from inteco_abs.mock_board import Device, front_end_of, parse_faults
from inteco_abs.realtime import RunMemory, StopFlag, handle_signals
from inteco_abs.realtime.processes.manual import DriveLoop, ManualClient, slowed
from inteco_abs.signals import Reason

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

_TURNING_S: Final = 5.0
"""Duration of ten turns by a quick hand."""
_SWITCHED_OFF: Final = parse_faults(["power-off@start"])


class MockRigAccess(RigAccess):
    """The configured board's mock in this process and in virtual time, powered up once for the whole procedure."""

    def __init__(self, config: RigConfig, seed: int = 0) -> None:
        super().__init__("sim:")
        self._now_ns = 0
        self.device = Device(config, self.now_ns, seed)
        self._front_end = front_end_of(self.device)

    def devices(self, config: RigConfig) -> list[FoundBoard]:
        """Return only the mock board."""
        return [FoundBoard("sim:", f"the mock {config.board.kind} board with the simulated rig, in this program")]

    def open(self, config: RigConfig) -> Board:
        """Return the mock board, called directly."""
        return board_behind(self.link(), config, self.now_ns)

    @contextmanager
    def held(self, config: RigConfig) -> Iterator[ManualClient]:
        """Hold the mock in this process, without a guardian: no motor turns."""
        config, stop = slowed(config), StopFlag()
        memory = RunMemory.private(TICK.size, round(config.loop.rate_hz))
        with handle_signals(stop.request), self.open(config) as board:
            board.require_writable()
            driven = DriveLoop(board, config, memory, stop)
            yield _VirtualClient(self, config.period_ns, memory, driven, stop)

    def link(self) -> Link:
        """A new link to the mock."""
        return InProcessLink(self._front_end)

    def now_ns(self) -> int:
        """Return the virtual time in ns."""
        return self._now_ns

    def pause(self, seconds: float) -> None:
        """Advance virtual time."""
        self._now_ns += round(seconds * 1e9)

    def beats(self, period_ns: int) -> Iterator[object]:
        """Beats that advance virtual time by one period each."""
        for beat in itertools.count():
            self.pause(period_ns * 1e-9)
            yield beat

    def turned(self, which: Wheel) -> None:
        """Turn the wheel forwards, with the lever lifted."""
        self.device.turn(which, TURNS, _TURNING_S)

    def powered(self, *, on: bool) -> None:
        """Switch the mock's power interface."""
        self.device.power(on=on)


class PacedMockRigAccess(MockRigAccess):
    """The mock in real time: for outputs, a process of its own, held like a real board.

    For reading, its time is virtual and never ahead of real time, so that a busy computer is not late.
    """

    def __init__(self, config: RigConfig, hold: Hold) -> None:
        super().__init__(config)
        self._hold = hold
        self._on = True
        self._due_s = 0.0

    def pause(self, seconds: float) -> None:
        """Advance virtual time, and wait for real time."""
        super().pause(seconds)
        now_s = time.monotonic()
        self._due_s = max(self._due_s + seconds, now_s)  # what took longer is not made up for
        time.sleep(self._due_s - now_s)

    @contextmanager
    def held(self, config: RigConfig) -> Iterator[ManualClient]:
        """Hold a mock that powers up now, its power interface switched as here."""
        with self._hold(config, self.address, outputs=True, faults=() if self._on else _SWITCHED_OFF) as side:
            yield side

    def powered(self, *, on: bool) -> None:
        """Switch the power interface, also of the next mock to be held."""
        super().powered(on=on)
        self._on = on


class _VirtualClient(ManualClient):
    """Client whose wait for a tick advances virtual time and drives the board."""

    def __init__(self, rig: RigAccess, period_ns: int, memory: RunMemory, driven: DriveLoop, stop: StopFlag) -> None:
        super().__init__(memory)
        self._rig = rig
        self._beats = rig.beats(period_ns)
        self._driven = driven
        self._stop = stop

    def now_ns(self) -> int:
        """Return the virtual time in ns."""
        return self._rig.now_ns()

    def next_ticks(self) -> npt.NDArray[np.void]:
        """Drive one beat; return its tick."""
        next(self._beats)
        self._driven.beat()
        return self.ticks()

    @property
    def reason(self) -> Reason:
        """OPERATOR_STOP after a signal."""
        return self._stop.wanted(self.now_ns())
