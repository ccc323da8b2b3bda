"""The loop: write outputs, read, decide, record, and nothing else."""

from __future__ import annotations

import gc
from itertools import islice
from typing import Protocol

from inteco_abs.boards import Board
from inteco_abs.control import Pipeline
from inteco_abs.errors import AbsError, describe_error
from inteco_abs.realtime.clock import Clock
from inteco_abs.realtime.gain_changes import GainChanges
from inteco_abs.realtime.ring import TickRing
from inteco_abs.signals import Reason, Timing


class StopSource(Protocol):
    """Says once a tick whether the run has to end."""

    def wanted(self, now_ns: int) -> Reason:
        """Return why the run must end now, or NONE."""
        ...


class StopFlag:
    """A request to stop, set by a signal handler in the loop's own process; never cleared."""

    __slots__ = ("_reason",)

    def __init__(self) -> None:
        self._reason = Reason.NONE

    @property
    def requested(self) -> bool:
        """Whether a stop was requested."""
        return self._reason is not Reason.NONE

    def request(self, reason: Reason = Reason.OPERATOR_STOP) -> None:
        """Stop the loop at its next tick; the first reason stays."""
        self._reason = self._reason or reason

    def wanted(self, _now_ns: int) -> Reason:
        """Return the requested reason, or NONE."""
        return self._reason


class Loop:
    """One experiment on an entered board, until the pipeline has finished.

    A tick writes the command of the tick before, reads the board, decides, records: one period of delay, always.
    `changes` may change gains just before it decides. With `paced_by_board` the board's tick starts it: a tick takes
    the board's report, decides, and answers; what it decides acts from the board's next tick on, the same delay.
    """

    def __init__(
        self,
        board: Board,
        pipeline: Pipeline,
        clock: Clock,
        ring: TickRing,
        stop: StopSource,
        changes: GainChanges | None = None,
        *,
        paced_by_board: bool = False,
    ) -> None:
        self.skipped = 0
        """Periods without a tick so far."""
        self._board = board
        self._pipeline = pipeline
        self._clock = clock
        self._beats = iter(clock)
        self._ring = ring
        self._stop = stop
        self._changes = changes
        self._busy_us = 0.0
        self._ticks = self._run_paced if paced_by_board else self._run
        self._answer_us = 0.0
        self._pacing = False

    def run(self, most: int | None = None) -> bool:
        """Run up to `most` ticks (None: to the end); True once the experiment is over.

        Feeds the watchdog. Collects no garbage: a collection takes as long as ten ticks, and the loop makes no cycles.
        """
        collecting = gc.isenabled()
        gc.disable()
        self._board.armed = True
        try:
            return self._ticks(most)
        finally:
            self._board.armed = False
            if collecting:
                gc.enable()

    def _run(self, most: int | None) -> bool:
        exchange, step, append = self._board.exchange, self._pipeline.step, self._ring.append
        now, wanted, pipeline = self._clock.now_ns, self._stop.wanted, self._pipeline
        change = None if self._changes is None or self._changes.over else self._changes.before
        command, busy_us = pipeline.command, self._busy_us
        for deadline, skipped in islice(self._beats, most):
            start = now()
            sample = exchange(command)
            read = now()
            if change is not None:
                change(sample)
            timing = Timing((start - deadline) * 1e-3, (read - start) * 1e-3, busy_us, skipped)
            tick = step(sample, wanted(read), timing)
            command = pipeline.command
            append(tick)
            self.skipped += skipped
            busy_us = (now() - read) * 1e-3
            if pipeline.finished:
                return True
        self._busy_us = busy_us
        return False

    def _run_paced(self, most: int | None) -> bool:
        board, pipeline, now, wanted = self._board, self._pipeline, self._clock.now_ns, self._stop.wanted
        change = None if self._changes is None or self._changes.over else self._changes.before
        if not self._pacing:
            board.start_pacing()
            self._pacing = True
        for _ in islice(self._beats, most):  # in virtual time the period passes here, else within `report`
            sample = board.report()
            read = now()
            if change is not None:
                change(sample)
            timing = Timing(board.late_ns * 1e-3, self._answer_us, self._busy_us, board.skipped)
            tick = pipeline.step(sample, wanted(read), timing)
            decided = now()
            board.answer(pipeline.command)
            answered = now()
            self._answer_us = (answered - decided) * 1e-3
            self._ring.append(tick)
            self.skipped += board.skipped
            self._busy_us = (now() - answered + decided - read) * 1e-3
            if pipeline.finished:
                return True
        return False


def detail_of(pipeline: Pipeline, board: Board) -> str:
    """Return the controller's or the link's last error if the run ended for it, else an empty text."""
    if pipeline.error is not None:
        return str(pipeline.error) if isinstance(pipeline.error, AbsError) else describe_error(pipeline.error)
    if pipeline.reason is Reason.MISSED_EXCHANGES and board.last_error is not None:
        return str(board.last_error)
    return ""
