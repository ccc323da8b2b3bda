"""A reference slip that changes while braking: by points, by a formula, or searched."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Final

from inteco_abs.config import ControllerConfig, RigConfig
from inteco_abs.control.controllers import Controller, Gain
from inteco_abs.control.formula import evaluate, parse_formula
from inteco_abs.control.functions import Function, function_of
from inteco_abs.control.gain_changes import REFERENCE, keeps_gain, set_gain
from inteco_abs.control.peak_search import PeakState, seek_peak
from inteco_abs.errors import ConfigIssue, shortened
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_OVER: Final = ("reference_at_s", "reference_at_rad_s")
_POINTS: Final = "reference_points"
_FORMULA: Final = "reference_formula"
_SEARCH: Final = "reference_search"
_CHECKED_S: Final = [i / 100 for i in range(101)]
_CHECKED_RAD_S: Final = [i * 5.0 for i in range(37)]


@dataclass(frozen=True, slots=True)
class PointsConstants:
    """The points, and the constants of the law that follows them."""

    over_time: bool
    """Whether `at` is time since braking began in s; else it is road speed in rad/s."""
    count: int
    at: list[float]
    """Rising; twice the same is a step."""
    slips: list[float]
    law: Any


@dataclass(frozen=True, slots=True)
class FormulaConstants:
    """The program of a formula, and the constants of the law that follows it."""

    uses_speed: bool
    count: int
    codes: list[int]
    numbers: list[float]
    law: Any


@dataclass(frozen=True, slots=True)
class SearchConstants:
    """The constants of the law that holds the slip that a search finds."""

    law: Any


_CONSTANTS: Final = PointsConstants | FormulaConstants | SearchConstants


@dataclass(slots=True)
class Stack:
    """What a formula computes with."""

    numbers: list[float]


@dataclass(slots=True)
class ReferenceState:
    """Time since the first demand, and the state of the law, whose `reference` is the slip to hold now."""

    elapsed_s: float
    source: Any
    """State of what finds that slip."""
    law: Any


def reference_at(k: PointsConstants, at: float) -> float:
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


def by_points(k: Any, s: ReferenceState, estimate: Estimate, _dt_s: float) -> float:
    """Slip to hold now, or NaN: without a valid estimate a reference over speed stays."""
    _, road_speed, _, valid, _ = estimate
    if k.over_time:
        return reference_at(k, s.elapsed_s)
    return reference_at(k, road_speed) if valid else math.nan


def by_formula(k: Any, s: ReferenceState, estimate: Estimate, _dt_s: float) -> float:
    """Slip to hold now, or NaN, as `by_points`."""
    _, road_speed, _, valid, _ = estimate
    if k.uses_speed and not valid:
        return math.nan
    return evaluate(k.codes, k.numbers, k.count, s.source.numbers, s.elapsed_s, road_speed)


def by_search(_k: Any, s: ReferenceState, estimate: Estimate, dt_s: float) -> float:
    """Slip to hold now, or NaN, as `by_points`."""
    _, road_speed, slip, valid, _ = estimate
    return seek_peak(s.source, s.elapsed_s, road_speed, slip, dt_s) if valid else math.nan


def _move(s: ReferenceState, slip: float, dt_s: float) -> None:
    """Give the law the slip to hold now; without one between 0 and 1 it holds the last."""
    if 0.0 < slip < 1.0:
        s.law.reference = slip
    s.elapsed_s += dt_s


def follow(
    k: Any, s: ReferenceState, estimate: Estimate, dt_s: float, law: Function, slip_now: Function
) -> BrakeDemand:
    """Demand of the law at the reference of this tick."""
    _move(s, slip_now(k, s, estimate, dt_s), dt_s)
    demand: BrakeDemand = law(k.law, s.law, estimate, dt_s)
    return demand


class FollowingController(ReferenceState):
    """A controller whose reference slip changes. Until its first demand it is that of time 0 and `start_rad_s`."""

    __slots__ = ("k", "slip_now")

    gains: ClassVar[tuple[Gain, ...]] = ()
    internals: ClassVar[tuple[Quantity, ...]] = ()

    def __init__(self, law: Any, chosen: ControllerConfig, start_rad_s: float) -> None:
        constants = getattr(law, "k", None)  # a law without a function may have none
        self.k: Any
        self.slip_now: Function
        source: Any = Stack([0.0])
        if chosen.reference_search:
            self.k, self.slip_now, source = SearchConstants(constants), by_search, PeakState(chosen.reference_slip)
        elif chosen.reference_formula is not None:
            program = parse_formula(chosen.reference_formula)
            count, source = len(program.codes), Stack([0.0] * len(program.codes))
            self.k = FormulaConstants(program.uses_speed, count, program.codes, program.numbers, constants)
            self.slip_now = by_formula
        else:
            over_time = chosen.reference_at_s is not None
            at, slips = list(chosen.reference_at_s or chosen.reference_at_rad_s or ()), chosen.reference_points or ()
            self.k, self.slip_now = PointsConstants(over_time, len(at), at, list(slips), constants), by_points
        super().__init__(0.0, source, law)
        law.reference = chosen.reference_slip
        if not chosen.reference_search:
            begin = Estimate(start_rad_s, start_rad_s, 0.0, valid=True)
            _move(self, self.slip_now(self.k, self, begin, 0.0), 0.0)

    @property
    def function(self) -> Function | None:
        """`follow` with the function of the law, or None where that has none."""
        law = function_of(self.law)
        return None if law is None else partial(follow, law=law, slip_now=self.slip_now)

    def keeps_gain(self, name: str, value: float) -> bool:
        """Whether the law keeps the gain; the reference follows its own course."""
        return name != REFERENCE and keeps_gain(self.law, name, value)

    def change_gain(self, name: str, value: float) -> None:
        """Give the law another value of a gain. Raises as `set_gain`."""
        set_gain(self.law, name, value)
        self.k = replace(self.k, law=getattr(self.law, "k", None))

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand of the law at the reference of this tick."""
        _move(self, self.slip_now(self.k, self, estimate, dt_s), dt_s)
        demand: BrakeDemand = self.law.update(estimate, dt_s)
        return demand


def following(controller: Controller, config: RigConfig) -> Controller:
    """`controller` with the reference of a checked configuration, itself where that is a constant."""
    chosen = config.controller
    if chosen.constant_slip is not None:
        return controller
    return FollowingController(controller, chosen, config.experiment.start_speed_rad_s)


def _followed(controller: Any, _constant: float) -> float:
    reference: float = controller.law.reference
    return reference


def _constant(_controller: Any, constant: float) -> float:
    return constant


def reference_function(controller: object) -> Callable[[Any, float], float]:
    """What gives the slip that a controller holds now, of it, or of its record, and the slip to hold if constant."""
    # one inside of a wrapper that passes its attributes on counts as well
    return _followed if isinstance(getattr(controller, "k", None), _CONSTANTS) else _constant


def check_reference(name: str, kind: type, table: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    """What is wrong with the slip to hold in the section [controller] for the controller `name`."""
    points, formula, given = table.get(_POINTS), table.get(_FORMULA), [key for key in _OVER if key in table]
    ways = [key for key in (_POINTS, _FORMULA, _SEARCH) if table.get(key) not in (None, False)]
    if not (ways or given):
        return
    if not hasattr(kind, "reference"):
        problem = (
            f"{name} holds a constant slip only: declare `reference = 0.0` in its class and read self.reference in "
            "each update, choose another controller, or give controller.reference_slip"
        )
        yield ConfigIssue(f"controller.{[*ways, *given][0]}", problem)
    if len(ways) > 1 or (given and ways not in ([], [_POINTS])):
        problem = f"give only one of {_POINTS} with one of {' and '.join(_OVER)}, {_FORMULA}, and {_SEARCH}"
        yield ConfigIssue(f"controller.{ways[-1]}", problem)
    elif isinstance(formula, str):
        yield from _check_formula(formula)
    elif ways not in ([_SEARCH], [_FORMULA]) and (points is None or len(given) != 1):
        problem = f"give {_POINTS} (slips) with one of {' and '.join(_OVER)}, both lists equally long"
        yield ConfigIssue(f"controller.{given[0] if points is None else _POINTS}", problem)
    elif ways == [_POINTS]:
        yield from _check_points(points, given[0], table[given[0]])


def _check_formula(text: str) -> Iterator[ConfigIssue]:
    """It must give a slip in the first second at every speed of the rig."""
    path = f"controller.{_FORMULA}"
    try:
        program = parse_formula(text)
    except ValueError as error:
        yield ConfigIssue(path, f"{shortened(text)}: {error}")
        return
    stack = [0.0] * len(program.codes)
    for speed in _CHECKED_RAD_S if program.uses_speed else _CHECKED_RAD_S[:1]:
        for t in _CHECKED_S:
            slip = evaluate(program.codes, program.numbers, len(stack), stack, t, speed)
            if not 0.0 < slip < 1.0:
                problem = (
                    f"{shortened(text)}: {slip:g} at t = {t:g} s and speed = {speed:g} rad/s; must be above 0 and "
                    "below 1 in the first second at every speed in 0..180 rad/s: limit it, as in "
                    "min(max(..., 0.01), 0.9)"
                )
                yield ConfigIssue(path, problem)
                return


def _check_points(points: Any, key: str, at: Any) -> Iterator[ConfigIssue]:
    if not (isinstance(at, list) and isinstance(points, list)):
        return  # the types are checked by the section
    if len(at) != len(points):
        problem = f"{len(points)} slips for {len(at)} values of {key}: both lists must be equally long"
        yield ConfigIssue(f"controller.{_POINTS}", problem)
    numbers = [each for each in at if isinstance(each, int | float)]
    if len(numbers) == len(at) and numbers != sorted(numbers):
        problem = f"{shortened(at)}: must rise from value to value; the same value twice is a step"
        yield ConfigIssue(f"controller.{key}", problem)
