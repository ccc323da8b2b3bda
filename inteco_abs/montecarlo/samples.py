"""Draws of a population as they are named on the command line, `hard:0-99`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from inteco_abs.errors import ConfigError, near_match
from inteco_abs.rig import POPULATIONS, RigVariation, draw, torque_margin

_NAMED: Final = re.compile(r"([^:]*):([0-9]+)(?:-([0-9]+))?")
_MOST_SEED: Final = (1 << 64) - 1
_MOST_DRAWS: Final = 100_000
HELD_SLIP: Final = 0.2
SPARE_NM: Final = 0.5
_NEEDY: Final = "capped"
"""Population some of whose rigs have a brake too weak to hold any slip, which says nothing of a controller."""


@dataclass(frozen=True, slots=True)
class SampleSet:
    """Rigs of one population, by their seeds."""

    population: str
    first: int
    last: int
    seeds: tuple[int, ...]
    """Of the rigs that count."""
    rigs: tuple[RigVariation, ...]
    """In the same order."""
    left_out: tuple[int, ...]
    """Seeds of rigs of `capped` that cannot hold slip 0.2 with 0.5 N m to spare."""

    @property
    def name(self) -> str:
        """As on the command line."""
        return f"{self.population}:{self.first}" + (f"-{self.last}" if self.last > self.first else "")


def parse_draws(text: str) -> SampleSet:
    """Draws named POPULATION:FIRST-LAST or POPULATION:SEED; raises ConfigError for anything else."""
    named = _NAMED.fullmatch(text.strip())
    if named is None:
        raise _mistake(f"{text!r}: must look like hard:0-99, or hard:7 for one rig")
    population, first, last = named[1], int(named[2]), int(named[3] or named[2])
    if population not in POPULATIONS:
        raise _mistake(f"no population {population!r}{near_match(population, POPULATIONS)}")
    if last < first:
        raise _mistake(f"{text}: the range is reversed; write {population}:{last}-{first}")
    if last > _MOST_SEED or last - first >= _MOST_DRAWS:
        raise _mistake(f"{text}: must be at most {_MOST_DRAWS} draws with seeds of at most {_MOST_SEED}")
    rigs = {seed: draw(population, seed) for seed in range(first, last + 1)}
    weak = {seed for seed, rig in rigs.items() if population == _NEEDY and torque_margin(rig, HELD_SLIP) < SPARE_NM}
    seeds = tuple(seed for seed in rigs if seed not in weak)
    if not seeds:
        raise _mistake(f"{text}: none of these rigs can hold slip {HELD_SLIP:g} with {SPARE_NM:g} N m to spare")
    return SampleSet(population, first, last, seeds, tuple(rigs[seed] for seed in seeds), tuple(sorted(weak)))


def _mistake(problem: str) -> ConfigError:
    return ConfigError.of("--rigs", problem)
