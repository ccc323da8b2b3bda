"""Outputs under the guard, one beat at a time, by a guarded process; every end leaves SAFE, read back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

from inteco_abs.commissioning.step import StepContext
from inteco_abs.config import RigConfig
from inteco_abs.errors import CommissioningError
from inteco_abs.realtime.processes.manual import ManualClient
from inteco_abs.signals import EXPLANATIONS, Command, Reason

PROVES_ITSELF: Final = "starting: the guardian is drilled first"
CONFIRMED_OFF: Final = "the board has confirmed that both outputs are off; wheels that turn coast for up to 48 s"


class WheelMotion(NamedTuple):
    """Counts and speeds of both wheels at one beat."""

    time_s: float
    """Time of the rig's clock."""
    wheel_counts: int
    """Since the board was opened."""
    road_counts: int
    wheel_speed_rad_s: float
    """Mean over the last 0.1 s."""
    road_speed_rad_s: float


class _EndedError(Exception):
    """The process that held the board has ended or is about to; it reports why."""


class Outputs:
    """Outputs of a held board. A request lasts half a second (manual.HELD_NS).

    So a program that hangs, dies or waits for an answer switches them off by doing nothing.
    """

    def __init__(self, side: ManualClient) -> None:
        self._side = side

    def beat(self, drive: float, brake: float) -> WheelMotion:
        """Request these duties and wait for the next tick. Raises CommissioningError if the guard ends them."""
        side = self._side
        side.request.keep_on(Command(drive, brake), side.now_ns())
        ticks = side.next_ticks()
        if side.reason is not Reason.NONE or not len(ticks):
            raise _EndedError
        last = ticks[-1]
        reason = Reason(int(last["reason"]))
        if reason is not Reason.NONE:
            raise CommissioningError(f"outputs switched off: {EXPLANATIONS[reason]}")
        counts = int(last["wheel_count"]), int(last["road_count"])
        speeds = float(last["wheel_speed_rad_s"]), float(last["road_speed_rad_s"])
        return WheelMotion(int(last["time_ns"]) * 1e-9, *counts, *speeds)

    def measured(self, name: str) -> float | None:
        """A quantity that the board itself measures, by the board's name for it, with both outputs off.

        None if it does not measure it; only the PCI board measures any. Raises CommissioningError if the guard takes
        the outputs away.
        """
        self._side.ask()
        self.beat(0.0, 0.0)
        while not self._side.answered:
            self.beat(0.0, 0.0)
        found = {known: value for known, value, *_ in (self._side.look or {}).get("readings", ())}
        return found.get(name)

    def hold(self, drive: float, brake: float, seconds: float) -> Iterator[WheelMotion]:
        """Hold these duties for so long, at least one beat; yields the motion at each beat."""
        first = self.beat(drive, brake)
        yield first
        while (motion := self.beat(drive, brake)).time_s - first.time_s < seconds:
            yield motion


@contextmanager
def outputs(context: StepContext, config: RigConfig) -> Iterator[Outputs]:
    """Hold the board for output by a process that a guardian watches; leaving ends with SAFE, read back.

    Raises KeyboardInterrupt after a signal, ReadOnlyError if the profile does not allow outputs, UnsafeError if SAFE
    was not confirmed.
    """
    with context.rig.held(config) as side:
        try:
            yield Outputs(side)
        except _EndedError:
            pass  # leaving raises the error of the process that held the board
        finally:
            side.request.take_away()
            reason = side.reason
    if reason is Reason.OPERATOR_STOP:
        context.operator.say(f"  {CONFIRMED_OFF}")
        raise KeyboardInterrupt
    if reason is not Reason.NONE:
        raise CommissioningError(f"outputs switched off: {EXPLANATIONS[reason]}")


def turns(counts: float, config: RigConfig) -> float:
    """Counts as full turns."""
    return counts / config.encoders.counts_per_turn
