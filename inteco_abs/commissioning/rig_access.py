"""Access to a rig: its board, its time, and what the operator does by hand."""

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
"""Full turns by hand that the operator is asked for."""


class Hold(Protocol):
    """Holds a board by a guarded process: `inteco_abs.experiment.manual_control`."""

    def __call__(
        self, config: RigConfig, board: str, *, outputs: bool, faults: tuple[Fault, ...] = ()
    ) -> AbstractContextManager[ManualClient]:
        """Hold the board at the address `board` for output, or for reading only."""
        ...


class RigAccess(ABC):
    """A rig to be commissioned; a simulated one also does what the operator is asked to do."""

    def __init__(self, address: str) -> None:
        self.address = address

    @abstractmethod
    def devices(self, config: RigConfig) -> list[FoundBoard]:
        """Boards that are present; nothing is written to them."""

    def bridge(self, config: RigConfig) -> dict[str, str]:  # noqa: ARG002  not every bus has a bridge
        """Facts that the board's bridge reports besides the frames."""
        return {}

    @abstractmethod
    def open(self, config: RigConfig) -> Board:
        """The board, not opened yet. Raises BoardError or ConfigError."""

    @abstractmethod
    def held(self, config: RigConfig) -> AbstractContextManager[ManualClient]:
        """Hold the board for output; leaving ends with SAFE, read back.

        Raises ReadOnlyError if the profile does not allow outputs, BoardError if the board cannot be opened,
        UnsafeError if SAFE was not confirmed.
        """

    @abstractmethod
    def now_ns(self) -> int:
        """Monotonic time at the rig, ns."""

    @abstractmethod
    def pause(self, seconds: float) -> None:
        """Wait."""

    @abstractmethod
    def beats(self, period_ns: int) -> Iterator[object]:
        """Endless beats, one a period."""

    def turned(self, which: Wheel) -> None:  # noqa: B027  only a simulated rig acts
        """The operator begins to turn this wheel."""

    def powered(self, *, on: bool) -> None:  # noqa: B027  only a simulated rig acts
        """The operator has switched the power interface or the emergency switch."""


class RealRigAccess(RigAccess):
    """A real rig in real time; `hold` holds its board for output."""

    def __init__(self, address: str, hold: Hold) -> None:
        super().__init__(address)
        self._hold = hold

    def devices(self, config: RigConfig) -> list[FoundBoard]:
        """Boards that are plugged into this computer."""
        return found_devices(self.address, config)

    def bridge(self, config: RigConfig) -> dict[str, str]:
        """Return ids, serial number and firmware dates of an RT-DAC/USB2."""
        name, _, rest = self.address.partition(":")
        return family_of(name).bridge_facts(rest, config)

    def open(self, config: RigConfig) -> Board:
        """The board at the address."""
        return open_board(self.address, config, self.now_ns)

    def held(self, config: RigConfig) -> AbstractContextManager[ManualClient]:
        """Hold the board by a process of its own, watched by a guardian that was drilled before."""
        return self._hold(config, self.address, outputs=True)

    def now_ns(self) -> int:
        """The system's monotonic clock."""
        return time.monotonic_ns()

    def pause(self, seconds: float) -> None:
        """Sleep."""
        time.sleep(seconds)

    def beats(self, period_ns: int) -> Iterator[object]:
        """Beats of the paced clock."""
        return iter(PacedClock(period_ns))
