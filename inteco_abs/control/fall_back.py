"""Falling back in steps: a law lowers its gains while its slip error swings from one side to the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

MOST_STEPS: Final = 5
"""Steps of the fall-back; the last leaves 1/32 of the gains."""
_CALM_S: Final = 0.2
"""Time within the band after which the law takes a step back up."""


@dataclass(slots=True)
class FallBackState:
    """Where a law has fallen back to."""

    steps: int = 0
    """Steps of the fall-back; each halves the gains."""
    calm_s: float = 0.0
    """Time since the slip error was beyond the band, or since the last step back up."""
    beyond: float = 0.0
    """Slip error when it was there last; 0 before, and since the reference moved."""
    supervised: float = 0.0
    """Reference that this was an error of."""


def fall_back(s: FallBackState, band: float, error: float, reference: float, dt_s: float) -> None:
    """Take a step for a slip error that has swung from beyond the band on one side to beyond it on the other.

    Each 0.2 s without an error beyond the band take a step back up. A reference that moves is no swing.
    """
    if s.supervised != reference:
        s.supervised, s.beyond = reference, 0.0
    s.calm_s += dt_s
    if abs(error) > band:
        if error * s.beyond < 0.0 and s.steps < MOST_STEPS:
            s.steps += 1
        s.beyond, s.calm_s = error, 0.0
    elif s.steps > 0 and s.calm_s > _CALM_S:
        s.steps, s.calm_s = s.steps - 1, 0.0


class FallBack(FallBackState):
    """Follows a law tick by tick from what is recorded of it, and has the same steps."""

    __slots__ = ("_band", "_last")

    def __init__(self, band: float) -> None:
        super().__init__()
        self._band = band
        self._last = 0.0

    def follow(self, error: float, reference: float, dt_s: float) -> int:
        """Steps after a tick in which the law had this slip error; a law that holds its demand has the last error."""
        if error != self._last:
            fall_back(self, self._band, error, reference, dt_s)
            self._last = error
        return self.steps
