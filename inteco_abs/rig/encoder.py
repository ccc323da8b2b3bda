"""Encoder of one wheel: from its angle to the count."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs import elementary
from inteco_abs.rig.rng import WORD, Word, mixed, normal_pair
from inteco_abs.rig.variation import EncoderVariation, RigVariation

_TURN_RAD: Final = 2.0 * math.pi


class Encoder:
    """The wheel's (`wheel=True`) or road's encoder of a rig; the counter is never reset.

    The noise of the n-th of all `readings` depends on `seed` and n alone.
    """

    __slots__ = ("_disc", "_noise", "readings", "seed")

    def __init__(self, variation: RigVariation, *, wheel: bool) -> None:
        self._disc = variation.wheel_encoder if wheel else variation.road_encoder
        self.seed = noise_seed(variation)
        self._noise = 0 if wheel else 1
        self.readings = 0

    def read(self, angle_rad: float) -> int:
        """Count with the wheel at `angle_rad`."""
        self.readings += 1
        noisy = self._disc.jitter_counts > 0.0
        return count(self._disc, angle_rad, normal_pair(self.seed, self.readings)[self._noise] if noisy else 0.0)


def count(disc: EncoderVariation, angle_rad: float, noise: float) -> int:
    """Count of `disc` with the wheel at `angle_rad`; `noise` is of a standard normal sequence."""
    position = angle_rad * (disc.counts_per_turn / _TURN_RAD) + disc.edge_counts
    if disc.eccentricity_counts > 0.0:
        position += disc.eccentricity_counts * elementary.sin(angle_rad + disc.eccentricity_phase_rad)
    if disc.jitter_counts > 0.0:
        position += disc.jitter_counts * noise
    return math.floor(position)


def noise_seed(variation: RigVariation) -> Word:
    """Seed of the noise of both encoders, each of which takes one number of every pair."""
    return mixed(variation.seed ^ WORD)
