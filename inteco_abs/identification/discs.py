"""Errors of the encoders' discs: what is left of the counts once and twice per turn.

A segment begins at an unknown angle of its disc, so segments have the amplitude of an error in common, not its phase.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.identification.segments import Floats

HARMONICS: Final = (1, 2)
"""Periods per turn."""
_BLOCKS: Final = 50
_FEWEST_BLOCKS: Final = 8
_BLOCK_SAMPLES: Final = 8
_NORMAL_95: Final = 1.96


class DiscError(NamedTuple):
    """A disc's error in one segment."""

    coefficients: Floats
    """Cosine and sine of each harmonic in turn, in the angle since the segment began, counts."""
    covariance: Floats
    """Their covariance, counts2."""

    def squared_amplitude(self, harmonic: int) -> tuple[float, float]:
        """Square of the amplitude without bias, and the variance of each coefficient, both in counts2."""
        places = slice(2 * harmonic - 2, 2 * harmonic)
        noise = float(np.trace(self.covariance[places, places]))
        return float(self.coefficients[places] @ self.coefficients[places]) - noise, 0.5 * noise


def columns(counts: Floats, counts_per_turn: int) -> Floats:
    """A constant, as the encoder's start angle is unknown, then cosine and sine of each harmonic."""
    angle = counts * (2.0 * math.pi / counts_per_turn)
    waves = [wave(harmonic * angle) for harmonic in HARMONICS for wave in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(angle), *waves])


def disc_error(counts: Floats, counts_per_turn: int, differences: Floats) -> DiscError | None:
    """The error of one disc from measured minus simulated counts; None if the wheel turns too few times.

    The covariance treats parts of a whole turn or more as independent: what the model leaves changes slowly, and over a
    turn it hardly adds to the sums with sine and cosine, whereas from sample to sample it is far from independent.
    """
    travelled = np.abs(np.diff(counts, prepend=counts[0])).cumsum() / counts_per_turn
    blocks = int(min(travelled[-1], len(counts) / _BLOCK_SAMPLES, _BLOCKS))
    if blocks < _FEWEST_BLOCKS:
        return None
    waves = columns(counts, counts_per_turn)
    inverse = np.linalg.inv(waves.T @ waves)
    found = inverse @ (waves.T @ differences)
    parts = waves * (differences - waves @ found)[:, None]
    sums = np.zeros((blocks, waves.shape[1]))
    np.add.at(sums, np.minimum((travelled * (blocks / travelled[-1])).astype(int), blocks - 1), parts)
    covariance = inverse @ (sums.T @ sums) @ inverse * (blocks / (blocks - waves.shape[1]))
    return DiscError(found[1:], covariance[1:, 1:])


def amplitude(errors: Sequence[DiscError], harmonic: int) -> tuple[float, float, float]:
    """Common amplitude of a harmonic in counts, and the ends of its interval of 95 %; segments count by precision.

    If segments differ by more than their own covariances explain, so does the interval.
    """
    squares, variances = np.array([error.squared_amplitude(harmonic) for error in errors]).T
    square = 0.0
    for _ in range(2):  # the precision of a square depends on it
        precisions = 1.0 / (4.0 * variances * (max(square, 0.0) + variances))
        square = float(precisions @ squares / precisions.sum())
    scatter = float(precisions @ (squares - square) ** 2) / max(len(errors) - 1, 1)
    off = _NORMAL_95 * math.sqrt(max(scatter, 1.0) / precisions.sum())
    return math.sqrt(max(square, 0.0)), math.sqrt(max(square - off, 0.0)), math.sqrt(max(square + off, 0.0))
