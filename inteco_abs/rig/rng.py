"""Random numbers that are equal on every machine and in every version: SplitMix64."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

from inteco_abs import elementary

Word: TypeAlias = int
"""A number of 64 bits, without a sign."""
WORD: Final = (1 << 64) - 1
_GOLDEN: Final = 0x9E3779B97F4A7C15
"""Odd, near 2^64 divided by the golden ratio: the step from one state to the next."""


def mixed(word: Word) -> Word:
    """`word` with every bit of it spread over all bits of the result, one to one."""
    word = (word ^ word >> 30) * 0xBF58476D1CE4E5B9 & WORD
    word = (word ^ word >> 27) * 0x94D049BB133111EB & WORD
    return word ^ word >> 31


class SplitMix64:
    """SplitMix64 of Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.

    It is a few lines of integer arithmetic, so a draw depends on its seed and this file alone. `seed` is in 0..2^64-1;
    raises ValueError outside.
    """

    __slots__ = ("_state",)

    def __init__(self, seed: int) -> None:
        if not 0 <= seed <= WORD:
            raise ValueError(f"seed = {seed!r}: must be in 0..2^64-1")
        self._state = seed

    def word(self) -> int:
        """Next 64 bits."""
        self._state = self._state + _GOLDEN & WORD
        return mixed(self._state)

    def uniform(self, low: float, high: float) -> float:
        """Next number, evenly spread over low..high, `high` excluded but for rounding."""
        return low + (high - low) * ((self.word() >> 11) * 2.0**-53)


def uniform(seed: Word, number: int) -> float:
    """Number `number` (1, 2, ...) of a sequence that is evenly spread over -1..1."""
    return (mixed(seed + number * _GOLDEN & WORD) >> 11) * 2.0**-52 - 1.0


def normal_pair(seed: Word, number: int) -> tuple[float, float]:
    """Pair `number` (1, 2, ...) of a standard normal sequence: Box and Muller on one word."""
    word = mixed(seed + number * _GOLDEN & WORD)
    radius = math.sqrt(-2.0 * elementary.log(((word >> 32) + 1) * 2.0**-32))
    angle = (word & 0xFFFFFFFF) * (2.0 * math.pi * 2.0**-32)
    sine, cosine = elementary.sin_cos(angle)
    return radius * cosine, radius * sine
