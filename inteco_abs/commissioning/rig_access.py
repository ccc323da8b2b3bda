"""Access to the rig: the board at an address, time, and what the operator does by hand."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Final, Literal, Protocol

from inteco_abs.boards import Board, family_of, open_board
from inteco_abs.config import RigConfig
from inteco_abs.host import FoundBoard, found_devices
from inteco_abs.mock_board import Fault
from inteco_abs.realtime import PacedClock
from inteco_abs.realtime.processes.manual import ManualClient

Wheel = Literal["wheel", "road"]
"""The upper, braked wheel, or the lower one."""
TURNS: Final = 10
"""Full turns that the person is asked for."""


class Hold(Protocol):
    """Has a guarded process hold a board: `inteco_abs.experiment.by_hand`."""

    def __call__(
        self, config: RigConfig, board: str, *, outputs: bool, faults: tuple[Fault, ...] = ()
    ) -> AbstractContextManager[ManualClient]:
        """While inside, the board at the address `board` is held for output, or only to be read."""
        ...


class RigAccess(ABC):
    """A rig to be commissioned.

    What the person is asked to do with it is told here too, just before: on a simulated rig nobody else would do it.
    """

    def __init__(self, address: str) -> None:
        self.address = address

    @abstractmethod
    def devices(self, config: RigConfig) -> list[FoundBoard]:
        """Boards that are there; nothing is written to any."""

    def bridge(self, config: RigConfig) -> dict[str, str]:  # noqa: ARG002  not every bus has a bridge that tells
        """What the board's bridge tells of itself besides the frames; its outputs are not concerned."""
        return {}

    @abstractmethod
    def open(self, config: RigConfig) -> Board:
        """The board, not entered yet. Raises BoardError or ConfigError."""

    @abstractmethod
    def held(self, config: RigConfig) -> AbstractContextManager[ManualClient]:
        """While inside, the board is held for output; leaving ends with SAFE, read back.

        Raises ReadOnlyError for a board that the configuration does not trust, BoardError if it cannot be opened,
        UnsafeError if SAFE was not confirmed.
        """

    @abstractmethod
    def now_ns(self) -> int:
        """Monotonic time at the rig."""

    @abstractmethod
    def pause(self, seconds: float) -> None:
        """Let so much time pass."""

    @abstractmethod
    def beats(self, period_ns: int) -> Iterator[object]:
        """Endless beats, one in each period."""

    def turned(self, which: Wheel) -> None:  # noqa: B027  people have hands
        """The person begins to turn this wheel."""

    def powered(self, *, on: bool) -> None:  # noqa: B027  likewise
        """The person has switched the power interface, or the emergency switch."""


class RealRigAccess(RigAccess):
    """A real rig, in real time; `hold` is what holds its board for output."""

    def __init__(self, address: str, hold: Hold) -> None:
        super().__init__(address)
        self._hold = hold

    def devices(self, config: RigConfig) -> list[FoundBoard]:
        """What this computer has plugged in."""
        return found_devices(self.address, config)

    def bridge(self, config: RigConfig) -> dict[str, str]:
        """Of an RT-DAC/USB2: ids, serial number and the dates of its firmware."""
        name, _, rest = self.address.partition(":")
        return family_of(name).bridge_facts(rest, config)

    def open(self, config: RigConfig) -> Board:
        """The board at the address."""
        return open_board(self.address, config, self.now_ns)

    def held(self, config: RigConfig) -> AbstractContextManager[ManualClient]:
        """By a process of its own, which a guardian watches that has proved itself before."""
        return self._hold(config, self.address, outputs=True)

    def now_ns(self) -> int:
        """The system's monotonic clock."""
        return time.monotonic_ns()

    def pause(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(seconds)

    def beats(self, period_ns: int) -> Iterator[object]:
        """Paced ones."""
        return iter(PacedClock(period_ns))
