"""How estimators, controllers and speed filters give their function, so that it can be compiled for many rigs.

Such a part is one function of constants and state. Its class derives from the state, a dataclass with slots, has the
constants as `k`, a frozen dataclass with slots, and names the function as `function` in its own body: then the
function called with `k` and the object itself does what `update` does. The leaves of both dataclasses are numbers,
flags, and lists of numbers that keep their length.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from inteco_abs.signals import BrakeDemand, Estimate

Function = Callable[..., Any]
"""Function of constants, state and more, or a `functools.partial` of one whose keywords are functions, too."""


def function_of(part: object) -> Function | None:
    """The function of `part`, or None: a subclass does not inherit it, as its `update` may do something else."""
    return getattr(part, "function", None) if "function" in vars(type(part)) else None


def finite_estimate(estimate: Estimate) -> bool:
    """Whether speeds and slip are finite; where they are not, Python may raise what machine code does not."""
    wheel_speed, road_speed, slip, _, _ = estimate
    return math.isfinite(wheel_speed) and math.isfinite(road_speed) and math.isfinite(slip)


def finite_demand(demand: BrakeDemand) -> bool:
    """As `finite_estimate`, of all numbers of a demand."""
    brake, torque, switching, (c0, c1, c2, c3) = demand
    numbers = math.isfinite(brake) and math.isfinite(torque) and math.isfinite(switching)
    return numbers and math.isfinite(c0) and math.isfinite(c1) and math.isfinite(c2) and math.isfinite(c3)
