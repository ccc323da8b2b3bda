"""Proves before each run that the one-shot in the emergency chain closes when it is fed, and opens when not.

Protections fail by not being armed, not by not firing (docs/facts/hazards.md#findings, 9).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from inteco_abs.boards import Board
from inteco_abs.errors import BoardError
from inteco_abs.signals import BoardFlags, Command

MOST_S: Final = 0.1
"""Time in which the contact has to follow: a one-shot of 50 ms and a relay's release."""
_LEAST_PERIODS: Final = 5
_SEE: Final = "see docs/watchdog.md, or set board.watchdog_pin and board.watchdog_contact_pin to -1 to do without it"


def prove_watchdog(board: Board, period_ns: int, wait: Callable[[float], None]) -> dict[str, str]:
    """Check that the contact of an entered board's watchdog opens, closes and opens; return facts for the session.

    Does nothing without a watchdog. All outputs are off. `wait` lets its argument pass, in seconds. Takes up to three
    times `MOST_S`. The board then begins again at tick 0. Raises BoardError if the contact does not follow in time.
    """
    if board.watchdog_closed is None:
        return {}
    watch = _ContactWatch(board, period_ns, wait)
    if not watch.sees(closed=False):
        raise BoardError(f"the watchdog's contact stays closed although nothing feeds it: is it welded? {_SEE}")
    if not watch.sees(closed=True, fed=True):
        raise BoardError(f"the watchdog's contact does not close although it is fed: has the one-shot power? {_SEE}")
    start_ns = watch.time_ns
    if not watch.sees(closed=False):
        raise BoardError(f"the watchdog's contact stays closed {MOST_S:g} s after its last pulse: is it welded? {_SEE}")
    opened_ns = watch.time_ns - start_ns
    if opened_ns < _LEAST_PERIODS * period_ns:
        problem = f"the watchdog's contact opens within {opened_ns * 1e-6:.1f} ms, less than {_LEAST_PERIODS} periods"
        raise BoardError(f"{problem}: a few late exchanges would cut the power. Make the one-shot longer; {_SEE}")
    board.begin()
    return {"watchdog_opened_ms": f"{opened_ns * 1e-6:.1f}"}


class _ContactWatch:
    """Exchanges of SAFE, one each period."""

    def __init__(self, board: Board, period_ns: int, wait: Callable[[float], None]) -> None:
        self.time_ns = 0
        """Time of the newest exchange, ns."""
        self._board = board
        self._period_s = period_ns * 1e-9
        self._wait = wait

    def sees(self, *, closed: bool, fed: bool = False) -> bool:
        """Return whether the contact gets `closed` within `MOST_S`, while the watchdog is fed or not."""
        board = self._board
        board.armed = fed
        try:
            for _ in range(max(2, round(MOST_S / self._period_s))):
                sample = board.exchange(Command.SAFE)
                self.time_ns = sample.time_ns
                if sample.board_flags is not BoardFlags.STALE and board.watchdog_closed is closed:
                    return True
                self._wait(self._period_s)
            return False
        finally:
            board.armed = False
