"""Checks that a user's class is a controller."""

from __future__ import annotations

import keyword
import math
from typing import Any

from inteco_abs.control import Controller, Gain
from inteco_abs.errors import ConfigError
from inteco_abs.format import INTERNALS
from inteco_abs.quantities import Quantity


def require_controller(path: str, kind: object, name: str) -> type[Controller]:
    """Return `kind` if it has update, gains and internals as `Controller`; else raise ConfigError."""
    problem = _problem_of(kind, name)
    if problem:
        raise ConfigError.of(path, problem)
    found: Any = kind
    checked: type[Controller] = found
    return checked


def _problem_of(kind: object, name: str) -> str:
    """Why `kind` is not a controller; empty if it is."""
    if not isinstance(kind, type):
        return f"{name} is not a class"
    if not callable(getattr(kind, "update", None)):
        return f"{name} has no method update(estimate, dt_s)"
    gains = getattr(kind, "gains", None)
    if not isinstance(gains, tuple) or not all(isinstance(gain, Gain) for gain in gains):
        return f"{name}.gains must be a tuple of inteco_abs.control.Gain; () if it has none"
    problems = [f"{name}.gains: {gain.name!r}: {problem}" for gain in gains if (problem := _problem_of_gain(gain))]
    internals = getattr(kind, "internals", None)
    if not isinstance(internals, tuple) or len(internals) > len(INTERNALS):
        problems.append(f"{name}.internals must be a tuple of at most {len(INTERNALS)} names; () if it logs none")
    elif not all(isinstance(each, str) or _is_quantity(each) for each in internals):
        problems.append(f"{name}.internals: each must be a name or an inteco_abs.quantities.Quantity")
    if not isinstance(getattr(kind, "estimator", ""), str):
        problems.append(f"{name}.estimator must be the name of the estimator that it needs; omit it if any will do")
    return problems[0] if problems else ""


def _is_quantity(each: object) -> bool:
    return isinstance(each, Quantity) and all(isinstance(text, str) for text in each)


def _problem_of_gain(gain: Gain) -> str:
    name: object = gain.name
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        return "must be a valid name of a constructor's argument"
    numbers: tuple[object, ...] = (gain.low, gain.default, gain.high)
    if not all(isinstance(number, int | float) and math.isfinite(number) for number in numbers):
        return f"low, default and high are {numbers}: must be finite numbers"
    if not gain.low <= gain.default <= gain.high:
        return f"the default {gain.default:g} must be in its range {gain.low:g}..{gain.high:g}"
    texts: tuple[object, ...] = (gain.unit, gain.meaning)
    return "" if all(isinstance(text, str) for text in texts) else "unit and meaning must be text"
