"""Settings with several values each, and the configurations that all their combinations make."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import Controller, control_check, preferred_estimator
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.montecarlo.policies import ESTIMATOR_NAMES

MOST_COMBINATIONS: Final = 1000
_CONTROLLER: Final = "controller.name"
_ESTIMATOR: Final = "estimator.name"
_GAIN: Final = "controller.gains."

Axes = dict[str, list[str]]
"""Values by dotted key, all as text."""


@dataclass(frozen=True, slots=True)
class Combination:
    """One configuration of a grid."""

    config: RigConfig
    varied: Mapping[str, str]
    """The settings besides controller and estimator that differ within the grid, as text."""

    @property
    def name(self) -> str:
        """Controller, estimator, and what else differs."""
        varied = [f"{key.rpartition('.')[2]}={value}" for key, value in self.varied.items()]
        return ", ".join([f"{self.config.controller.name} on {self.config.estimator.name}", *varied])


def combinations(
    settings: Sequence[str], controllers: Mapping[str, type[Controller]], file: Path | None = None
) -> list[Combination]:
    """Configurations of `key=a,b,c` settings over `file`, every value with every other.

    A key that is given twice has the values of both. A gain is for those of the chosen controllers that have it.
    The estimator may be `ideal`. Raises ConfigError with all mistakes, and for more than MOST_COMBINATIONS.
    """
    axes = _axes(settings)
    names = axes.pop(_CONTROLLER, None) or [load_config(file).controller.name]
    estimators = axes.pop(_ESTIMATOR, None) or [""]
    grids = {name: _of_controller(name, names, axes, controllers) for name in names}
    count = sum(len(estimators) * math.prod(map(len, grid.values())) for grid in grids.values())
    if count > MOST_COMBINATIONS:
        raise ConfigError.of(
            "--set", f"{count} combinations: must be at most {MOST_COMBINATIONS}; give fewer values at once"
        )
    check = control_check(controllers, ESTIMATOR_NAMES)
    found: list[Combination] = []
    mistakes: dict[ConfigIssue, None] = {}
    for name, estimator in product(names, estimators):
        for values in product(*grids[name].values()):
            chosen = dict(zip(grids[name], values, strict=True))
            own = [f"{_CONTROLLER}={name}", *([f"{_ESTIMATOR}={estimator}"] if estimator else [])]
            given = [*(f"{key}={value}" for key, value in chosen.items()), *own]
            try:
                config = load_config(file, given, [check], follows=preferred_estimator(controllers))
            except ConfigError as error:
                mistakes |= dict.fromkeys(error.mistakes)
                continue
            found.append(Combination(config, {key: chosen[key] for key in chosen if len(axes[key]) > 1}))
    if mistakes:
        raise ConfigError(list(mistakes))
    return found


def _axes(settings: Sequence[str]) -> Axes:
    axes: Axes = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        values = [value.strip() for value in split_list(text)]
        if not equals or not key.strip() or not all(values):
            raise ConfigError.of(f"--set {setting}", "must look like controller.gains.Mk=2 or ...=2,5,10")
        axes[key.strip()] = list(dict.fromkeys([*axes.get(key.strip(), ()), *values]))
    return axes


def split_list(text: str) -> list[str]:
    """Values between commas, but for commas within brackets or quotes."""
    values, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        else:
            depth += (letter in "[{(") - (letter in "]})")
        if letter == "," and not quote and depth == 0:
            values.append("")
        else:
            values[-1] += letter
    return values


def _of_controller(name: str, names: Sequence[str], axes: Axes, controllers: Mapping[str, type[Controller]]) -> Axes:
    """The axes without the gains of other controllers; a gain that none has stays, and is found to be a mistake."""

    def gains(which: str) -> set[str]:
        return {_GAIN + gain.name for gain in controllers[which].gains} if which in controllers else set()

    others = set().union(*map(gains, names)) - gains(name)
    return {key: values for key, values in axes.items() if key not in others}
