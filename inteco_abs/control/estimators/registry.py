"""What there is to know about an estimator before one is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from inteco_abs.config import EstimatorConfig, RigConfig, bounds, defaults, key_types
from inteco_abs.control.estimators.base import Estimator
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.rig import RigParameters

Maker = Callable[[RigConfig, RigParameters], Estimator]


class Parameter(NamedTuple):
    """One key of the section [estimator], with its range and unit."""

    name: str
    default: float
    low: float
    high: float
    unit: str
    meaning: str


class EstimatorSpec(NamedTuple):
    """One way to estimate: called with configuration and parameters of the rig, it makes a fresh estimator."""

    summary: str
    """In one line."""
    parameters: tuple[Parameter, ...]
    make: Maker
    works: type
    """The class behind it, whose docstring says how."""

    def __call__(self, config: RigConfig, parameters: RigParameters) -> Estimator:
        return self.make(config, parameters)


def require_estimator(path: str, found: object, name: str) -> EstimatorSpec:
    """`found` if it is an EstimatorSpec; else raises ConfigError."""
    if not isinstance(found, EstimatorSpec):
        raise ConfigError([ConfigIssue(path, f"{name} is not an inteco_abs.control.EstimatorSpec")])
    return found


def parameter(name: str, unit: str, meaning: str) -> Parameter:
    """The key `name` of the section, with default and range as the configuration has them."""
    key_type = key_types(EstimatorConfig)[name]
    low, high = bounds(key_type, "ge", "gt"), bounds(key_type, "le", "lt")
    return Parameter(name, defaults(EstimatorConfig)[name], low[0], high[0], unit, meaning)
