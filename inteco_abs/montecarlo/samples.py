"""Draws of a population as they are named on the command line, `hard:0-99`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from inteco_abs.errors import ConfigError, near_match
from inteco_abs.population_file import SUFFIX, read_population
from inteco_abs.rig import POPULATIONS, RigVariation, draw, torque_margin

_NAMED: Final = re.compile(r"(.*):([0-9]+)(?:-([0-9]+))?", re.DOTALL)
_MOST_SEED: Final = (1 << 64) - 1
_MOST_DRAWS: Final = 100_000_000
"""A metric of so many stops takes 0.8 GB of memory when its distribution is computed."""
HELD_SLIP: Final = 0.2
SPARE_NM: Final = 0.5
_NEEDY: Final = "capped"
"""Population some of whose rigs have a brake too weak to hold any slip, which says nothing of a controller; so may
those that are not shipped."""


@dataclass(frozen=True)
class SampleSet:
    """Rigs of one population, by their seeds; they are drawn when they are asked for."""

    population: str
    first: int
    last: int
    text: str = ""
    """Of a population that is not shipped, in TOML."""

    def __len__(self) -> int:
        """Number of draws, those that are left out included."""
        return self.last - self.first + 1

    @property
    def name(self) -> str:
        """The draws as on the command line."""
        return f"{self.population}:{self.first}" + (f"-{self.last}" if self.last > self.first else "")

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the rigs that count."""
        return tuple(self._drawn)

    @property
    def rigs(self) -> tuple[RigVariation, ...]:
        """In the same order."""
        return tuple(self._drawn.values())

    @property
    def left_out(self) -> tuple[int, ...]:
        """Seeds of rigs of `capped` or one's own population that cannot hold slip 0.2 with 0.5 N m to spare.

        So are those for which the rules of one's own population make an impossible rig.
        """
        return tuple(seed for seed in range(self.first, self.last + 1) if seed not in self._drawn)

    @cached_property
    def _drawn(self) -> dict[int, RigVariation]:
        return dict(self._strong())

    def _strong(self) -> Iterator[tuple[int, RigVariation]]:
        for seed in range(self.first, self.last + 1):
            try:
                rig = draw(self.text or self.population, seed)
            except ValueError:
                if not self.text:
                    raise
                continue
            if not (self.text or self.population == _NEEDY) or torque_margin(rig, HELD_SLIP) >= SPARE_NM:
                yield seed, rig

    @property
    def first_rig(self) -> RigVariation | None:
        """The first that counts; None if there is none."""
        return next((rig for _, rig in self._strong()), None)

    def split(self, size: int) -> Iterator[SampleSet]:
        """The draws in their order, in sets of at most `size`."""
        for first in range(self.first, self.last + 1, size):
            yield SampleSet(self.population, first, min(first + size - 1, self.last), self.text)


def parse_draws(text: str, populations: Mapping[str, str] | None = None) -> SampleSet:
    """Draws named POPULATION:FIRST-LAST or POPULATION:SEED; raises ConfigError for anything else.

    The population is shipped, or one of `populations` by name and text, or without those a .toml file.
    """
    named = _NAMED.fullmatch(text.strip())
    if named is None:
        raise _mistake(f"{text!r}: must look like hard:0-99, or hard:7 for one rig")
    population, first, last = named[1], int(named[2]), int(named[3] or named[2])
    described = ""
    if populations is None and population.endswith(SUFFIX):
        population, described = read_population(population, "--rigs")
    elif populations and population in populations:
        described = populations[population]
    elif population not in POPULATIONS:
        own = f", or a file as my-lab{SUFFIX}"
        raise _mistake(f"no population {population!r}{near_match(population, POPULATIONS)}{own}")
    if last < first:
        raise _mistake(f"{text}: the range is reversed; write {population}:{last}-{first}")
    if last > _MOST_SEED or last - first >= _MOST_DRAWS:
        raise _mistake(f"{text}: must be at most {_MOST_DRAWS} draws with seeds of at most {_MOST_SEED}")
    draws = SampleSet(population, first, last, described)
    if draws.first_rig is None:
        raise _mistake(f"{text}: none of these rigs can hold slip {HELD_SLIP:g} with {SPARE_NM:g} N m to spare")
    return draws


def _mistake(problem: str) -> ConfigError:
    return ConfigError.of("--rigs", problem)
