"""Outputs under the guard, held by a guarded process, one beat at a time; every end leaves SAFE, read back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

from inteco_abs.commissioning.step import StepContext
from inteco_abs.config import RigConfig
from inteco_abs.errors import ProbeError
from inteco_abs.realtime.processes.manual import ManualClient
from inteco_abs.signals import EXPLANATIONS, Command, Reason

PROVES_ITSELF: Final = "starting: the guardian is drilled first"


class Motion(NamedTuple):
    """Both wheels at one beat."""

    time_s: float
    """At the rig's clock."""
    wheel_counts: int
    """Since the board was entered."""
    road_counts: int
    wheel_speed_rad_s: float
    """Mean over the last 0.1 s."""
    road_speed_rad_s: float


class _EndedError(Exception):
    """The process that held the board has ended, or is about to; it says why."""


class Outputs:
    """The outputs of a board that is held for this program; each request is good for half a second (by_hand.HELD_NS).

    A program that hangs, dies or waits for an answer thus takes the outputs away by doing nothing.
    """

    def __init__(self, side: ManualClient) -> None:
        self._side = side

    def beat(self, drive: float, brake: float) -> Motion:
        """Request these duties and wait for the next tick. Raises ProbeError if the guard takes the outputs away."""
        side = self._side
        side.request.keep_on(Command(drive, brake), side.now_ns())
        ticks = side.next_ticks()
        if side.reason is not Reason.NONE or not len(ticks):
            raise _EndedError
        last = ticks[-1]
        reason = Reason(int(last["reason"]))
        if reason is not Reason.NONE:
            raise ProbeError(f"outputs switched off: {EXPLANATIONS[reason]}")
        counts = int(last["wheel_count"]), int(last["road_count"])
        speeds = float(last["wheel_speed_rad_s"]), float(last["road_speed_rad_s"])
        return Motion(int(last["time_ns"]) * 1e-9, *counts, *speeds)

    def measured(self, name: str) -> float | None:
        """What the board itself measures besides counts, by its own name, with both outputs off; None if it does not.

        Only the board on the PCI bus measures any. Raises ProbeError if the guard takes the outputs away.
        """
        self._side.ask()
        self.beat(0.0, 0.0)
        while not self._side.answered:
            self.beat(0.0, 0.0)
        found = {known: value for known, value, *_ in (self._side.look or {}).get("readings", ())}
        return found.get(name)

    def hold(self, drive: float, brake: float, seconds: float) -> Iterator[Motion]:
        """Beats for so long, at least one."""
        first = self.beat(drive, brake)
        yield first
        while (motion := self.beat(drive, brake)).time_s - first.time_s < seconds:
            yield motion


@contextmanager
def outputs(visit: StepContext, config: RigConfig) -> Iterator[Outputs]:
    """The board, held for output by a process that a guardian watches; a signal ends it with SAFE, read back.

    Raises KeyboardInterrupt then; ReadOnlyError for a board that the configuration does not trust, UnsafeError if SAFE
    was not confirmed.
    """
    with visit.bench.held(config) as side:
        try:
            yield Outputs(side)
        except _EndedError:
            pass  # leaving raises what the process says that held the board
        finally:
            side.request.take_away()
            reason = side.reason
    if reason is Reason.OPERATOR_STOP:
        visit.person.tell("  the board has confirmed that both outputs are off; wheels that turn coast for up to 48 s")
        raise KeyboardInterrupt
    if reason is not Reason.NONE:
        raise ProbeError(f"outputs switched off: {EXPLANATIONS[reason]}")


def turns(counts: float, config: RigConfig) -> float:
    """Full turns that so many counts are."""
    return counts / config.encoders.counts_per_turn
