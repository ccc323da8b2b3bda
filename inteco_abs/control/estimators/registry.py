"""What describes an estimator before it is made."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from inteco_abs.config import EstimatorConfig, RigConfig, bounds, defaults, key_types
from inteco_abs.control.estimators.base import Estimator, SpeedFilter, TwoWheels
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.rig import RigParameters

Factory = Callable[[RigConfig, RigParameters], Estimator]


class Parameter(NamedTuple):
    """One key of the section [estimator], with its range and unit."""

    name: str
    default: float
    low: float
    high: float
    unit: str
    meaning: str


ParameterCheck = Callable[[Mapping[str, Any], Mapping[str, Any]], Iterator[ConfigIssue]]
"""Checks the sections [estimator] and [loop] together, as they are written."""


def nothing_wrong(_estimator: Mapping[str, Any], _loop: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    """The check of an estimator whose parameters are independent of each other."""
    yield from ()


class EstimatorSpec(NamedTuple):
    """One kind of estimator; a call with configuration and nominal parameters makes a new one."""

    summary: str
    parameters: tuple[Parameter, ...]
    make: Factory
    works: type
    """The class, whose docstring explains the method."""
    check: ParameterCheck = nothing_wrong

    def __call__(self, config: RigConfig, parameters: RigParameters) -> Estimator:
        return self.make(config, parameters)


def on_both_wheels(make: Callable[[RigConfig], SpeedFilter]) -> Factory:
    """An estimator of two filters, one for each wheel."""
    return lambda config, parameters: TwoWheels(make(config), make(config), parameters)


def require_estimator(path: str, found: object, name: str) -> EstimatorSpec:
    """`found` if it is an EstimatorSpec; else raises ConfigError."""
    if not isinstance(found, EstimatorSpec):
        raise ConfigError.of(path, f"{name} is not an inteco_abs.control.EstimatorSpec")
    return found


def parameter(name: str, unit: str, meaning: str) -> Parameter:
    """The key `name` of the section, with default and range as the configuration has them."""
    key_type = key_types(EstimatorConfig)[name]
    low, high = bounds(key_type, "ge", "gt"), bounds(key_type, "le", "lt")
    return Parameter(name, defaults(EstimatorConfig)[name], low[0], high[0], unit, meaning)
