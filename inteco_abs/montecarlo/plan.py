"""What a sweep brakes, as text that has a hash, and in units that any process can brake."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, Final, NamedTuple

from inteco_abs.config import trusted_config
from inteco_abs.errors import ConfigError
from inteco_abs.montecarlo.batch_run import Experiment
from inteco_abs.montecarlo.grid import Combination
from inteco_abs.montecarlo.policies import ConfiguredPolicy
from inteco_abs.montecarlo.samples import SampleSet, parse_draws
from inteco_abs.plugins import Controllers
from inteco_abs.version import __version__, source_sha256

RUN_UP_RAD_S: Final = 15.0
"""Below the start speed: nearly a second of driving, in which estimators settle and learn."""
_UNITS: Final = 256
_FEWEST: Final = 10
"""Draws in a unit: handing it over takes a fraction of braking them."""
_MOST: Final = 2000
"""Draws in a unit: a worker that is killed loses some ten seconds of a shipped controller's stops."""


class Unit(NamedTuple):
    """Part of a sweep, braked as a whole."""

    combination: int
    """Index in the grid."""
    population: str
    first: int
    """Seed."""
    draws: int
    """How many."""

    @property
    def name(self) -> str:
        """Name of its files, without suffix."""
        return "-".join(map(str, self))


@dataclass(frozen=True)
class SweepPlan:
    """Every configuration of a grid on every range of draws."""

    grid: Sequence[Combination]
    draws: Sequence[SampleSet]
    sources: Mapping[str, bytes] = field(default_factory=dict)
    """Source of each controller of the user's own, by its name."""
    run_up: bool = True
    """False: the stops begin at the start speed, and braking begins at once."""

    @property
    def count(self) -> int:
        """Number of draws on all configurations, those that are left out included."""
        return len(self.grid) * sum(map(len, self.draws))

    def rows(self) -> Iterator[tuple[SampleSet, int]]:
        """Range of draws and index of the combination, range by range."""
        return ((draws, number) for draws in self.draws for number in range(len(self.grid)))

    def units(self) -> Iterator[Unit]:
        """All units, row by row; two ranges that overlap may have units in common."""
        return (unit for row in self.rows() for unit in self.units_of(*row))

    def units_of(self, draws: SampleSet, combination: int) -> Iterator[Unit]:
        """Those of one row."""
        size = min(max(self.count // _UNITS, _FEWEST), _MOST)
        return (Unit(combination, part.population, part.first, len(part)) for part in draws.split(size))

    def experiment(self, unit: Unit) -> tuple[SampleSet, Experiment]:
        """The unit's draws, and their stops."""
        text = self.populations.get(unit.population, "")
        draws = SampleSet(unit.population, unit.first, unit.first + unit.draws - 1, text)
        config = self.grid[unit.combination].config
        maker = ConfiguredPolicy(config, source=self.sources.get(config.controller.name, b""))
        start = max(0.0, config.experiment.start_speed_rad_s - RUN_UP_RAD_S) if self.run_up else None
        return draws, Experiment(draws.rigs, config, maker, start)

    @cached_property
    def populations(self) -> dict[str, str]:
        """Text of each population that is not shipped, by its name."""
        return {draws.population: draws.text for draws in self.draws if draws.text}

    @cached_property
    def description(self) -> dict[str, Any]:
        """All that the result depends on, for JSON."""
        return {
            "program": {"version": __version__, "source_sha256": source_sha256()},
            "packages": _packages(tuple({one.config.controller.name: None for one in self.grid})),
            "controllers": {name: source.decode("utf-8", "surrogateescape") for name, source in self.sources.items()},
            "draws": [draws.name for draws in self.draws],
            "populations": self.populations,
            "run_up": self.run_up,
            "grid": [{"varied": dict(one.varied), "config": one.config.to_toml()} for one in self.grid],
        }

    @cached_property
    def name(self) -> str:
        """SHA-256 of the description."""
        return _digest(self.description)

    def to_json(self) -> str:
        """The description with its hash."""
        return json.dumps({"schema_version": 1, "sha256": self.name, "sweep": self.description}, indent=1)

    @staticmethod
    def from_json(text: str, path: str, option: str) -> SweepPlan:
        """The plan that was written to `path`. Raises ConfigError if another program made it, or if it was changed."""

        def mistake(problem: str) -> ConfigError:
            return ConfigError.of(option, f"{path}: {problem}")

        try:
            content = json.loads(text)
            sweep = content["sweep"]
            if content["sha256"] != _digest(sweep):
                raise mistake("has been changed since it was written; begin a new folder")
            grid = [Combination(trusted_config(one["config"]), one["varied"]) for one in sweep["grid"]]
            sources = {name: one.encode("utf-8", "surrogateescape") for name, one in sweep["controllers"].items()}
            plan = SweepPlan(
                grid, [parse_draws(one, sweep["populations"]) for one in sweep["draws"]], sources, sweep["run_up"]
            )
            program, packages = sweep["program"], sweep["packages"]
        except (ValueError, LookupError, TypeError, AttributeError) as error:
            raise mistake("is not the description of a sweep") from error
        if program != plan.description["program"]:
            theirs = f"{program['version']} (sources {program['source_sha256'][:12]})"
            ours = f"{__version__} (sources {source_sha256()[:12]})"
            problem = f"made by inteco-abs {theirs}, and this is {ours}, whose numbers may differ"
            raise mistake(f"{problem}: use that one, or begin a new folder")
        if packages != plan.description["packages"]:
            raise mistake(f"needs {packages}, and here is {plan.description['packages']}: install the same")
        if sweep != plan.description:
            raise mistake("is not the description of a sweep")
        return plan


def _digest(description: Mapping[str, Any]) -> str:
    text = json.dumps(description, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _packages(controllers: Sequence[str]) -> dict[str, str]:
    """Package of each controller that is installed with one, with its version."""
    installed = Controllers()
    origins = {name: installed.origin(name).package for name in controllers if name in installed}
    return {name: package for name, package in origins.items() if package}
