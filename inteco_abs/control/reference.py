"""A reference slip that changes while braking: linear between points, over time or over road speed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final

from inteco_abs.config import RigConfig
from inteco_abs.control.controllers import Controller, Gain
from inteco_abs.control.functions import Function, function_of
from inteco_abs.errors import ConfigIssue, shortened
from inteco_abs.signals import BrakeDemand, Estimate

_OVER: Final = ("reference_at_s", "reference_at_rad_s")
_POINTS: Final = "reference_points"


@dataclass(frozen=True, slots=True)
class ReferenceConstants:
    """The points, and the constants of the law that follows them."""

    over_time: bool
    """Whether `at` is time since braking began in s; else it is road speed in rad/s."""
    count: int
    at: list[float]
    """Rising; twice the same is a step."""
    slips: list[float]
    law: Any


@dataclass(slots=True)
class ReferenceState:
    """Time since the first demand, and the state of the law, whose `reference` is the slip to hold now."""

    elapsed_s: float
    law: Any


def reference_at(k: ReferenceConstants, at: float) -> float:
    """Slip at this time or speed: linear between points, that of the nearer end outside of them."""
    low, high = 0, k.count
    while low < high:
        middle = (low + high) // 2
        if k.at[middle] <= at:
            low = middle + 1
        else:
            high = middle
    if low == 0:
        return k.slips[0]
    if low == k.count:
        return k.slips[low - 1]
    share = (at - k.at[low - 1]) / (k.at[low] - k.at[low - 1])
    return k.slips[low - 1] + (k.slips[low] - k.slips[low - 1]) * share


def _move(k: ReferenceConstants, s: ReferenceState, estimate: Estimate, dt_s: float) -> None:
    """Give the law the slip to hold now; without a valid estimate a reference over speed stays."""
    _, road_speed, _, valid, _ = estimate
    if k.over_time:
        s.law.reference = reference_at(k, s.elapsed_s)
    elif valid:
        s.law.reference = reference_at(k, road_speed)
    s.elapsed_s += dt_s


def follow(k: ReferenceConstants, s: ReferenceState, estimate: Estimate, dt_s: float, law: Function) -> BrakeDemand:
    """Demand of the law at the reference of this tick."""
    _move(k, s, estimate, dt_s)
    demand: BrakeDemand = law(k.law, s.law, estimate, dt_s)
    return demand


class FollowingController(ReferenceState):
    """A controller whose reference slip changes. Until its first demand it is that of time 0, or of `start_rad_s`."""

    __slots__ = ("k",)

    gains: ClassVar[tuple[Gain, ...]] = ()
    internals: ClassVar[tuple[str, ...]] = ()

    def __init__(self, law: Any, at: list[float], slips: list[float], over_time: bool, start_rad_s: float) -> None:
        super().__init__(0.0, law)
        # a law without a function may have no constants
        self.k = ReferenceConstants(over_time, len(at), at, slips, getattr(law, "k", None))
        law.reference = reference_at(self.k, 0.0 if over_time else start_rad_s)

    @property
    def function(self) -> Function | None:
        """`follow` with the function of the law, or None where that has none."""
        law = function_of(self.law)
        return None if law is None else partial(follow, law=law)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand of the law at the reference of this tick."""
        _move(self.k, self, estimate, dt_s)
        demand: BrakeDemand = self.law.update(estimate, dt_s)
        return demand


def following(controller: Controller, config: RigConfig) -> Controller:
    """`controller` with the reference of a checked configuration, itself where that is a constant."""
    chosen = config.controller
    if chosen.reference_points is None:
        return controller
    over_time = chosen.reference_at_s is not None
    at = chosen.reference_at_s if over_time else chosen.reference_at_rad_s
    start = config.experiment.start_speed_rad_s
    return FollowingController(controller, list(at or ()), list(chosen.reference_points), over_time, start)


def _followed(controller: Any, _constant: float) -> float:
    reference: float = controller.law.reference
    return reference


def _constant(_controller: Any, constant: float) -> float:
    return constant


def reference_function(controller: object) -> Callable[[Any, float], float]:
    """What gives the slip that a controller holds now, of it, or of its record, and the slip to hold if constant."""
    # one inside of a wrapper that passes its attributes on counts as well
    return _followed if isinstance(getattr(controller, "k", None), ReferenceConstants) else _constant


def check_reference(name: str, kind: type, table: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    """What is wrong with the points in the section [controller] for the controller `name`."""
    points, given = table.get(_POINTS), [key for key in _OVER if table.get(key) is not None]
    if points is None and not given:
        return
    if points is None or len(given) != 1:
        problem = f"give {_POINTS} (slips) with one of {' and '.join(_OVER)}, both lists equally long"
        yield ConfigIssue(f"controller.{given[0] if points is None else _POINTS}", problem)
        return
    at = table[given[0]]
    if not hasattr(kind, "reference"):
        problem = (
            f"{name} holds a constant slip only: declare `reference = 0.0` in its class and read self.reference in "
            "each update, choose another controller, or give controller.reference_slip"
        )
        yield ConfigIssue(f"controller.{_POINTS}", problem)
    if not (isinstance(at, list) and isinstance(points, list)):
        return  # the types are checked by the section
    if len(at) != len(points):
        problem = f"{len(points)} slips for {len(at)} values of {given[0]}: both lists must be equally long"
        yield ConfigIssue(f"controller.{_POINTS}", problem)
    numbers = [each for each in at if isinstance(each, int | float)]
    if len(numbers) == len(at) and numbers != sorted(numbers):
        problem = f"{shortened(at)}: must rise from value to value; the same value twice is a step"
        yield ConfigIssue(f"controller.{given[0]}", problem)
