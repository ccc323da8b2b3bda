"""Encoder of one wheel: from its angle to the count."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs import elementary
from inteco_abs.rig.rng import WORD, Word, mixed, normal_pair, uniform
from inteco_abs.rig.variation import EncoderVariation, RigVariation

_TURN_RAD: Final = 2.0 * math.pi
_GOLDEN_RATIO: Final = 0.5 * (math.sqrt(5.0) - 1.0)
_LATCH: Final = 0xD1B54A32D192ED03
"""Makes another sequence of a seed."""


class Encoder:
    """The wheel's (`wheel=True`) or road's encoder of a rig; the counter is never reset.

    The noise of the n-th of all `readings` depends on `seed` and n alone.
    """

    __slots__ = ("_disc", "_latch_jitter_s", "_noise", "readings", "seed")

    def __init__(self, variation: RigVariation, *, wheel: bool) -> None:
        self._disc = variation.wheel_encoder if wheel else variation.road_encoder
        self.seed = noise_seed(variation)
        self._latch_jitter_s = variation.latch_jitter_s
        self._noise = 0 if wheel else 1
        self.readings = 0

    def read(self, angle_rad: float, speed_rad_s: float) -> int:
        """Count with the wheel at `angle_rad`, which turns at `speed_rad_s`."""
        self.readings += 1
        if self._latch_jitter_s > 0.0:
            angle_rad += speed_rad_s * latch_error_s(self._latch_jitter_s, self.seed, self.readings)
        noisy = self._disc.jitter_counts > 0.0
        return count(self._disc, angle_rad, normal_pair(self.seed, self.readings)[self._noise] if noisy else 0.0)


def count(disc: EncoderVariation, angle_rad: float, noise: float) -> int:
    """Count of `disc` with the wheel at `angle_rad`; `noise` is of a standard normal sequence."""
    position = angle_rad * (disc.counts_per_turn / _TURN_RAD) + disc.edge_counts
    if disc.eccentricity_counts > 0.0:
        position += disc.eccentricity_counts * elementary.sin(angle_rad + disc.eccentricity_phase_rad)
    if disc.second_harmonic_counts > 0.0:
        position += disc.second_harmonic_counts * elementary.sin(2.0 * angle_rad + disc.second_harmonic_phase_rad)
    if disc.damaged_counts > 0.0:
        turns = (angle_rad - disc.damage_angle_rad) / _TURN_RAD
        whole = math.floor(turns)
        position -= disc.damaged_counts * whole + min((turns - whole) * disc.counts_per_turn, disc.damaged_counts)
    if disc.jitter_counts > 0.0:
        position += disc.jitter_counts * noise
    counted = math.floor(position)
    return counted - _lost(disc, counted) if disc.lost_share > 0.0 else counted


def _lost(disc: EncoderVariation, counted: int) -> int:
    """Counts that are missed of so many: one in each block of 1 / lost_share, where the golden ratio puts it.

    Two neighbouring blocks never lose the same count, so that the counter does not turn back.
    """
    blocks = counted * disc.lost_share
    block = math.floor(blocks)
    place = block * _GOLDEN_RATIO + disc.edge_counts
    return block + 1 if blocks - block > place - math.floor(place) else block


def latch_error_s(latch_jitter_s: float, seed: Word, reading: int) -> float:
    """Time by which the counts of a reading, 1 at first, are latched after its time stamp, s."""
    return latch_jitter_s * uniform(seed ^ _LATCH, reading)


def noise_seed(variation: RigVariation) -> Word:
    """Seed of the noise of both encoders, each of which takes one number of every pair."""
    return mixed(variation.seed ^ WORD)
