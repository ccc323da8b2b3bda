"""Tolerances of replayed signals in value and time, and shifts of flags.

The terms are those of Simulink Test: absolute, relative, leading, lagging
(docs/facts/sessions.md#comparison-of-signals).
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.format import TICK, Role

Array = npt.NDArray[Any]

OUTPUTS: Final = tuple(column.name for column in TICK.columns if column.role is Role.OUTPUT)
_KINDS: Final = {column.name: column.kind for column in TICK.columns if column.role is Role.OUTPUT}
DISCRETE: Final = tuple(name for name, kind in _KINDS.items() if kind.code != "d")
"""Outputs that are flags or enumerations."""
ALL: Final = "*"
_SYNTAX: Final = "must look like brake=1e-9, slip=1e-9:1e-6, or phase=::0.002:0.002"
_LONGEST_S: Final = 1.0
"""Largest lead and lag; a longer one would reach another stop."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Accepts a replayed value that is near a logged one at about the same time.

    Near: |replayed - logged| <= max(abs, rel*|logged|), or between two such values; NaN is near NaN. The replayed
    signal may come up to `lead_s` earlier or `lag_s` later.
    """

    abs: float = 0.0
    rel: float = 0.0
    lead_s: float = 0.0
    lag_s: float = 0.0

    def accepts(self, logged: Array, replayed: Array, time_ns: Array) -> Array:
        """Whether each tick's replayed value is accepted."""
        times_ns = time_ns.astype(np.int64)
        first = np.searchsorted(times_ns, times_ns - round(self.lag_s * 1e9), side="left")
        end = np.searchsorted(times_ns, times_ns + round(self.lead_s * 1e9), side="right")
        near = self._near if logged.dtype.kind == "f" else _same
        return near(logged, replayed, first, end)

    def _near(self, logged: Array, replayed: Array, first: Array, end: Array) -> Array:
        slack = np.maximum(self.abs, self.rel * np.abs(np.where(np.isfinite(logged), logged, 0.0)))
        low, high = np.full(len(logged), math.inf), np.full(len(logged), -math.inf)
        for rows, at in _window(first, end):
            low[rows] = np.fmin(low[rows], (logged - slack)[at])
            high[rows] = np.fmax(high[rows], (logged + slack)[at])
        not_numbers = _same(np.isnan(logged), np.isnan(replayed), first, end)
        between: Array = (low <= replayed) & (replayed <= high)
        return between | (np.isnan(replayed) & not_numbers)


def _same(logged: Array, replayed: Array, first: Array, end: Array) -> Array:
    found = np.zeros(len(logged), np.bool_)
    for rows, at in _window(first, end):
        found[rows] |= logged[at] == replayed[rows]
    return found


def _window(first: Array, end: Array) -> Iterator[tuple[Array, Array]]:
    """Rows, and for each of them one row of its window `first`..`end`, until all have been yielded."""
    for k in range(int((end - first).max())):
        rows = np.flatnonzero(first + k < end)
        yield rows, first[rows] + k


@dataclass(frozen=True, slots=True)
class Shift:
    """A change of a flag, phase or reason at different ticks in replay and log."""

    field: str
    value: str
    """The value after the change."""
    logged_tick: int | None
    replayed_tick: int | None
    late_ticks: int | None
    """Delay of the replay; None if one of them does not have the change."""


class Shifts:
    """Differing changes of one discrete output, added in blocks.

    The n-th change to a value in the log is compared with the n-th in the replay.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._values: list[int | None] = [None, None]
        """Newest value in the log, and in the replay."""
        self._changes: dict[int, tuple[deque[int], deque[int]]] = defaultdict(lambda: (deque(), deque()))
        """Ticks of the changes to each value that the other side does not have yet."""
        self._found: list[Shift] = []

    def add(self, ticks: Array, logged: Array, replayed: Array) -> None:
        """Add a block: numbers of its ticks, values in the log and in the replay."""
        for side, values in enumerate((logged, replayed)):
            before = self._values[side]
            rows = (np.flatnonzero(values[1:] != values[:-1]) + 1).tolist()
            for row in [0, *rows] if int(values[0]) != before else rows:
                self._changes[int(values[row])][side].append(int(ticks[row]))
            self._values[side] = int(values[-1])
        for value, (then, now) in self._changes.items():
            while then and now:
                self._compare(value, then.popleft(), now.popleft())

    def _compare(self, value: int, then: int | None, now: int | None) -> None:
        if then != now:
            members = _KINDS[self._name].members
            name = members(value).name if members else str(bool(value)).lower()
            self._found.append(Shift(self._name, name, then, now, None if then is None or now is None else now - then))

    def found(self) -> list[Shift]:
        """All of them by time, once every block was added."""
        for value, (then, now) in self._changes.items():
            for tick in then:
                self._compare(value, tick, None)
            for tick in now:
                self._compare(value, None, tick)
        self._changes.clear()

        def first_tick(shift: Shift) -> int:
            return cast(int, shift.replayed_tick if shift.logged_tick is None else shift.logged_tick)

        return sorted(self._found, key=first_tick)


def bits(values: Array) -> Array:
    """Values as unsigned integers of the same width: NaN equals itself, and -0.0 differs from 0.0."""
    return np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")


def parse_tolerances(texts: Iterable[str]) -> dict[str, Tolerance]:
    """Tolerances by field, from texts such as `brake=1e-9:1e-6`; `*` is every field, and a later text wins.

    Raises ConfigError with every mistake.
    """
    found: dict[str, Tolerance] = {}
    mistakes: list[ConfigIssue] = []
    for text in texts:
        try:
            found.update(_parsed(text))
        except ValueError as error:
            mistakes.append(ConfigIssue(f"--tol {text}", str(error)))
    if mistakes:
        raise ConfigError(mistakes)
    return found


def _parsed(text: str) -> dict[str, Tolerance]:
    """Return the tolerances in one text. Raises ValueError with what is wrong with it."""
    name, equals, numbers = (part.strip() for part in text.partition("="))
    parts = numbers.split(":")
    if not (name and equals and numbers) or len(parts) > 4:
        raise ValueError(f"{_SYNTAX}: FIELD=ABS[:REL[:LEAD_S[:LAG_S]]]")
    if name != ALL and name not in _KINDS:
        raise ValueError(f"no output {name!r}{near_match(name, _KINDS)}")
    tolerance = Tolerance(*map(_number, parts))
    for words, value in (("lead", tolerance.lead_s), ("lag", tolerance.lag_s)):
        if value > _LONGEST_S:
            raise ValueError(f"a {words} of {value:g} s: must be at most {_LONGEST_S:g} s")
    if name == ALL:
        return dict.fromkeys(_KINDS, tolerance)
    if name in DISCRETE and (tolerance.abs or tolerance.rel):
        raise ValueError(f"{name} is not a number and can only come early or late, as in {name}=::0.002:0.002")
    return {name: tolerance}


def _number(text: str) -> float:
    try:
        value = float(text) if text.strip() else 0.0
    except ValueError:
        raise ValueError(f"{text!r} is not a number; {_SYNTAX}") from None
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{text}: must be finite and at least 0")
    return value
