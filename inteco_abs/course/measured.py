"""What a grading measures: a value for each case and measure."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from inteco_abs.course.exercise import Exercise
from inteco_abs.montecarlo import SampleSet
from inteco_abs.rig import RigVariation

_SEEDS: Final = 1 << 40
_TRIES: Final = 1000


@dataclass(frozen=True, slots=True)
class Measured:
    """Values of each measure, one per case.

    NaN is missing, and keeps no limit; None is of a case to which the measure does not apply.
    """

    cases: tuple[str, ...]
    """Names of the rigs or recordings."""
    values: Mapping[str, Sequence[float | None]]
    own: float
    """What the score compares, as are the next two; infinite if there is nothing."""
    zero: float
    hundred: float
    notes: tuple[str, ...] = ()
    """What else its author should know."""

    @property
    def score(self) -> float:
        """Points, 0 to 100."""
        if not self.own < self.zero:
            return 0.0
        if self.own <= self.hundred:
            return 100.0
        return 100.0 * math.log(self.zero / self.own) / math.log(self.zero / self.hundred)


class Draw:
    """All that is drawn in one grading, from its secret seed and the exercise; each name has its own numbers."""

    def __init__(self, exercise: Exercise, seed: int) -> None:
        self._exercise = exercise
        self._seed = seed

    def numbers(self, name: str) -> random.Random:
        """The same sequence each time."""
        return random.Random(f"{self._seed}:{self._exercise.name}:{name}")

    def rigs(self) -> dict[str, RigVariation]:
        """Rigs by name, as for `--rig`; those that cannot hold the reference are left out."""
        population, text = self._exercise.rigs
        numbers, found = self.numbers("rigs"), dict[str, RigVariation]()
        for _ in range(_TRIES * self._exercise.cases):
            one = numbers.randrange(_SEEDS)
            rig = SampleSet(population, one, one, text).first_rig
            if rig is not None:
                found[f"{population}:{one}"] = rig
            if len(found) == self._exercise.cases:
                break
        return found


def median(values: Sequence[float]) -> float:
    """The median, in which a missing value counts as infinite."""
    ordered = sorted(math.inf if math.isnan(value) else value for value in values)
    return 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
