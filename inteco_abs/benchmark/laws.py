"""The laws of the benchmark: a controller and an estimator with their numbers, and where those come from."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import Controller, control_check, gains_in_force, preferred_estimator
from inteco_abs.errors import ConfigError
from inteco_abs.montecarlo import Combination
from inteco_abs.sessions import atomic_write

_SHIPPED: Final = Path(__file__).with_name("laws.toml")
FIXED_GAINS: Final = ("published", "shipped")
"""`gains_from` of laws that are shown as their source or this program has them, and are not tuned."""
DEFAULT_ESTIMATOR: Final = "kalman"
"""Of a law that needs none in particular: the same for all."""
_KEYS: Final = {"name", "controller", "estimator", "gains_from"}
_JERK: Final = "estimator.jerk_density"
_GAIN: Final = "controller.gains."


@dataclass(frozen=True)
class Law:
    """One row of the benchmark."""

    name: str
    controller: str
    """Name as of `--controller`."""
    estimator: str
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Gains and the estimator's parameters by dotted key; those left out have their defaults."""
    gains_from: str = "defaults"
    """Origin of the numbers: one of FIXED_GAINS, `tuned`, or `defaults`."""

    def config(self, controllers: Mapping[str, type[Controller]]) -> RigConfig:
        """The configuration of its stops. Raises ConfigError for names and numbers that cannot be."""
        names = [f"controller.name={json.dumps(self.controller)}", f"estimator.name={self.estimator}"]
        settings = [*names, *(f"{key}={value!r}" for key, value in self.numbers.items())]
        follows = preferred_estimator(controllers)
        return load_config(settings=settings, checks=[control_check(controllers)], follows=follows)

    def combination(self, controllers: Mapping[str, type[Controller]]) -> Combination:
        """Its place in a sweep."""
        return Combination(self.config(controllers), {"law": self.name})

    def searched(self, controllers: Mapping[str, type[Controller]]) -> dict[str, tuple[float, float, float]]:
        """Start, lowest and highest value of each number that is tuned: a tenth to ten times the start, in its range.

        These are the gains, and the Kalman filter's jerk density; a number that is 0 stays.
        """
        config = self.config(controllers)
        limits = {gain.name: (gain.low, gain.high) for gain in controllers[self.controller].gains}
        found = {
            f"{_GAIN}{name}": (value, max(value / 10.0, limits[name][0]), min(value * 10.0, limits[name][1]))
            for name, value in gains_in_force(config, controllers).items()
            if value > 0.0
        }
        if self.estimator == DEFAULT_ESTIMATOR:
            jerk = config.estimator.jerk_density
            found[_JERK] = (jerk, jerk / 10.0, jerk * 10.0)
        return found

    def tuned(self, numbers: Mapping[str, float]) -> Law:
        """The same law with numbers that a search has found."""
        return replace(self, numbers={**self.numbers, **numbers}, gains_from="tuned")


def shipped_laws() -> list[Law]:
    """Those that `benchmark` compares."""
    return read_laws(_SHIPPED)


def read_laws(path: Path) -> list[Law]:
    """Laws of a TOML file with a table `[[law]]` each. Raises ConfigError for what is not one."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        return [_law(one) for one in table["law"]]
    except OSError as error:
        raise ConfigError.of("--laws", f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        problem = f"not a file of laws, as `benchmark --tune` writes it: {type(error).__name__}: {error}"
        raise ConfigError.of("--laws", f"{path}: {problem}") from error


def _law(table: Mapping[str, Any]) -> Law:
    if unknown := set(table) - _KEYS:
        raise ValueError(f"unknown keys {', '.join(sorted(unknown))}: must be some of {', '.join(sorted(_KEYS))}")
    controller, estimator = dict(table["controller"]), dict(table["estimator"])
    gains = {f"{_GAIN}{key}": float(value) for key, value in controller.get("gains", {}).items()}
    others = {f"estimator.{key}": float(value) for key, value in estimator.items() if key != "name"}
    origin = str(table.get("gains_from", "defaults"))
    return Law(str(table["name"]), str(controller["name"]), str(estimator["name"]), gains | others, origin)


def write_laws(laws: Iterable[Law], path: Path) -> None:
    """Write a file that `read_laws` reads."""
    with atomic_write(path) as part:
        part.write_text("\n".join(map(_text, laws)), encoding="utf-8", newline="\n")


def _text(law: Law) -> str:
    def numbers(prefix: str) -> Iterator[str]:
        return (
            f"{key.removeprefix(prefix)} = {value!r}" for key, value in law.numbers.items() if key.startswith(prefix)
        )

    gains = ", ".join(numbers(_GAIN))
    controller = f"name = {json.dumps(law.controller)}" + (f", gains = {{ {gains} }}" if gains else "")
    estimator = ", ".join([f"name = {json.dumps(law.estimator)}", *numbers("estimator.")])
    return (
        f"[[law]]\nname = {json.dumps(law.name)}\ncontroller = {{ {controller} }}\nestimator = {{ {estimator} }}\n"
        f"gains_from = {json.dumps(law.gains_from)}\n"
    )
