"""Outputs under the guard, one beat at a time; whatever ends it, SAFE is the last thing written, and read back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NamedTuple

from inteco_abs.boards import Board
from inteco_abs.config import RigConfig
from inteco_abs.control import Guard, SpeedWindow
from inteco_abs.errors import ProbeError
from inteco_abs.lab.step import Visit
from inteco_abs.realtime import StopWord
from inteco_abs.realtime.hearing import hearing
from inteco_abs.signals import EXPLANATIONS, Command, Estimate, Reason

_WINDOW_S: Final = 0.1
_NO_ESTIMATE: Final = Estimate(0.0, 0.0, 0.0, valid=False)


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


class Outputs:
    """The outputs of an entered board. Each command passes the guard, and goes out with the beat after."""

    def __init__(self, board: Board, config: RigConfig, beats: Iterator[object], stop: StopWord) -> None:
        self._board = board
        self._beats = beats
        self._stop = stop
        self._guard = Guard(config)
        length = round(_WINDOW_S * config.loop.rate_hz)
        self._wheel = SpeedWindow(config.encoders.counts_per_turn, length)
        self._road = SpeedWindow(config.encoders.counts_per_turn, length)
        self._command = Command.SAFE

    def beat(self, drive: float, brake: float) -> Motion:
        """One beat; the duties go out with the next. Raises ProbeError if the guard takes the outputs away."""
        next(self._beats)
        sample = self._board.exchange(self._command)
        if self._stop.requested:
            raise KeyboardInterrupt
        self._command = self._guard.admit(Command(drive, brake), sample, _NO_ESTIMATE)
        if self._guard.reason is not Reason.NONE:
            raise ProbeError(f"outputs taken away: {self._explanation()}")
        wheel = self._wheel.update(sample.time_ns, sample.wheel_count)
        road = self._road.update(sample.time_ns, sample.road_count)
        return Motion(sample.time_ns * 1e-9, sample.wheel_count, sample.road_count, wheel, road)

    def hold(self, drive: float, brake: float, seconds: float) -> Iterator[Motion]:
        """Beats for so long, at least one."""
        first = self.beat(drive, brake)
        yield first
        while (motion := self.beat(drive, brake)).time_s - first.time_s < seconds:
            yield motion

    def _explanation(self) -> str:
        reason = self._guard.reason
        detail = f" ({self._board.last_error})" if reason is Reason.MISSED_EXCHANGES and self._board.last_error else ""
        return EXPLANATIONS[reason] + detail


@contextmanager
def outputs(visit: Visit, config: RigConfig) -> Iterator[Outputs]:
    """The board, entered for output. Signals end it with SAFE, then KeyboardInterrupt.

    Raises ReadOnlyError for a board that the configuration does not trust, UnsafeError if SAFE was not confirmed.
    """
    stop = StopWord()
    try:
        with hearing(stop.request), visit.bench.open(config) as board:
            board.insist()
            yield Outputs(board, config, visit.bench.beats(config.period_ns), stop)
    except KeyboardInterrupt:
        stop.request()
    if stop.requested:
        visit.person.tell("  the board has confirmed that both outputs are off; wheels that turn coast for up to 48 s")
        raise KeyboardInterrupt


def turns(counts: float, config: RigConfig) -> float:
    """Full turns that so many counts are."""
    return counts / config.encoders.counts_per_turn
