"""Measures how long exchanges with a board take, and whether they allow a rate."""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from typing import Final, NamedTuple

from inteco_abs.boards import Board
from inteco_abs.errors import BoardError
from inteco_abs.signals import BoardFlags, Command

_MOST_FAILURES_IN_A_ROW: Final = 20
"""Limit of failed exchanges: as many as the guard allows on a real board at 2 kHz."""
_TURNS, _TURN_TRIALS = 5, 100
"""Turns, and trials in each: engines alternate, so that a disturbance of the computer affects all of them."""
_WORTH_IT: Final = 0.9
"""Another engine replaces the usual one if it takes less than this share of its time."""
_RATE_TRIALS: Final = 1000
RATE_MARGIN: Final = 1.2
"""Factor on an exchange's time that a period has to have."""


class Quantiles(NamedTuple):
    """Nearest-rank quantiles of a set of times, us."""

    p50: float
    p99: float
    p999: float
    max: float

    def __str__(self) -> str:
        return f"p50 {self.p50:.1f}, p99 {self.p99:.1f}, p99.9 {self.p999:.1f}, max {self.max:.1f} us"


def quantiles(times_us: Collection[float]) -> Quantiles:
    """Return the nearest-rank quantiles of at least one time, us."""
    ordered = sorted(times_us)
    return Quantiles(*(ordered[-(-len(ordered) * permille // 1000) - 1] for permille in (500, 990, 999, 1000)))


def round_trips(board: Board, count: int) -> list[float]:
    """Exchange SAFE `count` times with an entered board; return how long each success took, us.

    Call it in a process with the loop's tuning, else it measures the process and not the board. The board then begins
    again at tick 0. Raises BoardError after twenty failures in a row.
    """
    board.hurried = False
    try:
        return _times_us(board, count)
    finally:
        board.hurried = True
        board.begin()


def _times_us(board: Board, count: int) -> list[float]:
    times_us: list[float] = []
    failed = 0
    for _ in range(count):
        start_ns = time.monotonic_ns()
        sample = board.exchange(Command.SAFE)
        end_ns = time.monotonic_ns()
        if not sample.board_flags & BoardFlags.STALE:
            times_us.append((end_ns - start_ns) / 1e3)
            failed = 0
            continue
        failed += 1
        if failed >= _MOST_FAILURES_IN_A_ROW:
            raise BoardError(f"the board does not answer: {board.last_error}") from board.last_error
    return times_us


def choose_engine(board: Board) -> dict[str, str]:
    """Time SAFE exchanges with each engine of an entered board, and choose the one with the best 99th percentile.

    The usual engine stays unless another is a tenth quicker. Returns the engine in use and the times of each as facts;
    nothing for a board without engines. Raises BoardError if the board answers with none of them.
    """
    engines = board.engines
    if not engines:
        return {"engine": board.engine} if board.engine else {}
    times_us: dict[str, list[float]] = {engine: [] for engine in engines}
    failure = None
    for engine in engines * _TURNS:
        board.engine = engine
        try:
            tried = round_trips(board, _TURN_TRIALS)
        except BoardError as error:
            tried, failure = [], error
        times_us[engine] += tried + [math.inf] * (_TURN_TRIALS - len(tried))
    measured = {engine: quantiles(times) for engine, times in times_us.items()}
    usual = engines[0]
    best = min(engines, key=lambda engine: measured[engine].p99)
    if failure is not None and math.isinf(measured[best].p50):
        raise failure
    board.engine = best if measured[best].p99 < _WORTH_IT * measured[usual].p99 else usual
    return {"engine": board.engine, **{f"exchanges, {engine}": str(times) for engine, times in measured.items()}}


def require_rate(board: Board, period_ns: int) -> dict[str, str]:
    """Raise BoardError with a possible rate if exchanges with an entered board take longer than a period.

    Chooses the engine first. The 99th percentile of a thousand exchanges decides, failed ones included, with all
    outputs off: a run survives one lost or late exchange in a hundred. Returns facts for the session.
    """
    facts = choose_engine(board)
    times_us = round_trips(board, _RATE_TRIALS)
    failed = _RATE_TRIALS - len(times_us)
    spread = quantiles([*times_us, *[math.inf] * failed])
    period_us = period_ns * 1e-3
    facts["exchanges"] = f"{spread}; {failed} of {_RATE_TRIALS} failed"
    if spread.p99 <= period_us:
        return facts
    seen = "; ".join(f"{name}: {found}" for name, found in facts.items())
    if math.isinf(spread.p99):
        raise BoardError(f"{failed} of {_RATE_TRIALS} exchanges with the board failed: {board.last_error} ({seen})")
    rate_hz = math.floor(1e6 / (RATE_MARGIN * spread.p99))
    raise BoardError(
        f"the board's exchanges take up to {spread.p99:.0f} us (99 % of {_RATE_TRIALS}), longer than the period of "
        f"{period_us:g} us. If this computer is busy, try again; else set loop.rate_hz to {rate_hz} or less, with "
        f"an estimator.window_s of at least one period. See inteco-abs doctor --board ({seen})"
    )
