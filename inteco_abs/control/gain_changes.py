"""Gains, and the reference slip, that change while a run lasts.

Each change takes effect at one tick, before the decision, and the session keeps it with that tick, so that a replay
changes the same at the same tick. Only what a controller declares can change, within its range; the guard cannot.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final, NamedTuple

from inteco_abs.control.controllers import Gain
from inteco_abs.errors import near_match
from inteco_abs.quantities import number_hint

REFERENCE: Final = "reference_slip"
"""Name of the slip to hold among the gains."""
_LEAST_SLIP: Final = 0.001
_MOST_SLIP: Final = 0.999
_FORM: Final = re.compile(r"(?P<name>[^=@]+)=(?P<value>[^=@]+)@(?P<when>[^=@]+)")
_WHEN: Final = re.compile(
    r"(?:brake(?P<braking>[1-9][0-9]{0,3})?(?:\+(?=.)|$))?"
    r"(?:#(?P<ticks>[0-9]{1,9})|(?P<number>[0-9]{1,6}(?:\.[0-9]{1,9})?)(?P<unit>us|ms|s))?"
)
_SECONDS: Final = {"us": 1e-6, "ms": 1e-3, "s": 1.0}
EXAMPLE: Final = "as in Mk=5@brake+200ms, reference_slip=0.3@brake2, Mq=0.5@3.5s, Mk=5@#7000"


class GainChange(NamedTuple):
    """A gain that was changed while the run lasted."""

    tick: int
    """First tick that is decided with the new value; at least 1: before, the configuration holds."""
    name: str
    """Of a gain, or `reference_slip`."""
    value: float


class PlannedChange(NamedTuple):
    """A change that the configuration plans."""

    name: str
    value: float
    braking: int
    """Number of the braking from whose beginning its time counts; 0: from the first tick."""
    ticks: int | None
    """Number of ticks after that; None if it is given as a time."""
    seconds: float = 0.0

    def delay(self, rate_hz: float) -> int:
        """Number of ticks after that beginning, of a loop with this rate."""
        return round(self.seconds * rate_hz) if self.ticks is None else self.ticks


def parse_change(text: str) -> PlannedChange:
    """The change that `text` plans, NAME=VALUE@WHEN. Raises ValueError with what is wrong and how to write it."""
    found = _FORM.fullmatch(text.strip())
    if found is None:
        raise ValueError(f"must be NAME=VALUE@WHEN, {EXAMPLE}")
    name, value, when = (found[part].strip() for part in ("name", "value", "when"))
    try:
        number = float(value)
    except ValueError:
        raise ValueError(f"{value!r} is not a number{number_hint(value)}; {EXAMPLE}") from None
    at = _WHEN.fullmatch(when)
    if at is None or not when:
        problem = "must be a time since the first tick, or since a braking began, in us, ms, s or in ticks (#)"
        raise ValueError(f"{when!r} {problem}; {EXAMPLE}")
    braking = int(at["braking"] or 1) if when.startswith("brake") else 0
    ticks = int(at["ticks"]) if at["ticks"] else None
    seconds = float(at["number"]) * _SECONDS[at["unit"]] if at["number"] else 0.0
    return PlannedChange(name, number, braking, ticks, seconds)


def planned_changes(texts: Iterable[str] | None) -> tuple[PlannedChange, ...]:
    """The changes of a checked configuration."""
    return tuple(map(parse_change, texts or ()))


def reference_gain(slip: float) -> Gain:
    """The reference slip as a gain, with the range in which it may change."""
    return Gain(REFERENCE, slip, _LEAST_SLIP, _MOST_SLIP, "1", "slip to hold")


def value_problem(name: str, value: float, gains: Sequence[Gain]) -> str:
    """Why `name` cannot become `value`, with what is allowed; empty if it can. `gains` are those that may change."""
    gain = next((gain for gain in gains if gain.name == name), None)
    if gain is None:
        if name.partition(".")[0] == "guard":
            return f"{name}: the guard's limits cannot change while a run lasts; set them before"
        known = [gain.name for gain in gains]
        hint = near_match(name, known) if known else "; nothing can change with this controller"
        return f"{name}: not a gain that can change while a run lasts{hint}"
    if not gain.low <= value <= gain.high:  # NaN is not either
        unit = "" if gain.unit == "1" else f" {gain.unit}"
        return f"{name} = {value:g}: must be in {gain.low:g}..{gain.high:g}{unit} ({gain.meaning})"
    return ""


def changeable_gains(controller: Any, declared: Iterable[Gain], values: Mapping[str, float]) -> tuple[Gain, ...]:
    """The reference slip and the gains that can change, each with its value of `values` as its default.

    A gain can if the controller keeps it as it got it, under its own name, or has a method `change_gain`; a wrapper has
    `keeps_gain` as well. One that the class declares as `fixed` cannot, nor can the reference where it follows points
    or a formula.
    """
    known = [reference_gain(values[REFERENCE]), *declared]
    found = [gain._replace(default=values[gain.name]) for gain in known if not gain.fixed]
    return tuple(gain for gain in found if keeps_gain(controller, gain.name, gain.default))


def set_gain(controller: Any, name: str, value: float) -> None:
    """Give a controller another value of a gain, or of `reference_slip`, which `changeable_gains` has.

    Raises what a user's controller raises, and AttributeError for a gain that it does not keep.
    """
    own = getattr(controller, "change_gain", None)
    if own is not None and (name != REFERENCE or hasattr(controller, "keeps_gain")):
        own(name, value)
    elif name == REFERENCE:
        controller.reference = value
    elif _in_constants(controller, name):
        controller.k = replace(controller.k, **{name: value})
    elif hasattr(controller, name):
        setattr(controller, name, value)
    else:
        raise AttributeError(f"the controller keeps no gain {name}")


def keeps_gain(controller: Any, name: str, value: float) -> bool:
    """Whether `set_gain` can change this gain, whose value is `value` now."""
    asked = getattr(controller, "keeps_gain", None)
    if asked is not None:
        kept: bool = asked(name, value)
        return kept
    if name != REFERENCE and hasattr(controller, "change_gain"):
        return True
    if name == REFERENCE:
        holder, name = controller, "reference"
    else:
        holder = controller.k if _in_constants(controller, name) else controller
    found, of_class = getattr(holder, name, None), getattr(type(holder), name, None)
    can = not isinstance(of_class, property) or of_class.fset is not None
    return can and type(found) is float and found == value


def _in_constants(controller: Any, name: str) -> bool:
    k = getattr(controller, "k", None)
    return is_dataclass(k) and any(field.name == name for field in fields(k))


def changes_not_made(texts: Iterable[str] | None, made: Iterable[GainChange]) -> tuple[str, ...]:
    """The planned changes whose time did not come."""
    left = [(change.name, change.value) for change in made]
    missing = []
    for text in texts or ():
        planned = parse_change(text)
        if (planned.name, planned.value) in left:
            left.remove((planned.name, planned.value))
        else:
            missing.append(text)
    return tuple(missing)


class ChangePlan:
    """Finds the planned changes that are due, tick by tick; a tick without one costs a comparison."""

    def __init__(self, planned: Iterable[PlannedChange], rate_hz: float) -> None:
        self._waiting = [(each, each.delay(rate_hz)) for each in planned]
        self._begun = {0: 0}
        """Tick in which each braking began; 0 is the run's first tick."""
        self._braking = False
        self._next = self._earliest()

    @property
    def over(self) -> bool:
        """Whether no change is left."""
        return not self._waiting

    def due(self, tick: int, *, braking: bool) -> Sequence[PlannedChange]:
        """Changes to make before the decision on `tick`; `braking`: whether the tick before was in that phase."""
        if braking is not self._braking:
            self._braking = braking
            if braking:
                self._begun[len(self._begun)] = tick - 1
                self._next = self._earliest()
        if tick < self._next:
            return ()
        now = [change for change, delay in self._waiting if self._tick_of(change, delay) <= tick]
        self._waiting = [each for each in self._waiting if self._tick_of(*each) > tick]
        self._next = self._earliest()
        return now

    def _tick_of(self, change: PlannedChange, delay: int) -> float:
        begun = self._begun.get(change.braking)
        return math.inf if begun is None else max(begun + delay, 1)

    def _earliest(self) -> float:
        return min((self._tick_of(*each) for each in self._waiting), default=math.inf)
