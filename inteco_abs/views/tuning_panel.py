"""A line of the dashboard with which a person changes gains while a run lasts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

from inteco_abs.control import Gain
from inteco_abs.errors import AbsError, on_one_line
from inteco_abs.views.text_lines import Line, apart

_HINT: Final = "Tab: next gain; up, down, or a number and Enter: change "
_STEP: Final = 0.05
"""Share of the value by which an arrow key changes it."""
_FROM_ZERO: Final = 0.001
"""Share of the gain's range by which it changes one that is 0."""
_KEYS: Final = re.compile(rb"\x1b\[[0-9;]*[A-Za-z~]|\x1bO[A-D]|.", re.DOTALL)
_UP, _DOWN, _RIGHT, _LEFT = (frozenset((b"\x1b[" + each, b"\x1bO" + each)) for each in (b"A", b"B", b"C", b"D"))
_NEXT: Final = _RIGHT | {b"\t"}
_BEFORE: Final = _LEFT | {b"\x1b[Z"}
_TYPED: Final = frozenset(bytes([each]) for each in b"0123456789.-+eE")
_ENTER: Final = frozenset((b"\r", b"\n"))
_ERASE: Final = frozenset((b"\x7f", b"\b"))
_CANCEL: Final = b"\x1b"
_LONGEST: Final = 24


class Tunable(Protocol):
    """What changes the gains of a run."""

    @property
    def gains(self) -> Sequence[Gain]:
        """Gains that can change."""
        ...

    @property
    def values(self) -> Mapping[str, float]:
        """Their values in force now."""
        ...

    def change(self, name: str, value: float) -> int:
        """Change a gain; return the tick from which on it holds. Raises AbsError."""
        ...


class TuningPanel:
    """Chooses a gain by Tab or the arrows to the sides, changes it by the other two or by a number and Enter."""

    def __init__(self, tuner: Tunable) -> None:
        self._tuner = tuner
        self._chosen = 0
        self._typed = ""
        self._said = ("", "")
        """What came of the last key, and its style."""

    def press(self, keys: bytes) -> None:
        """Act on keys as a terminal sends them; waits until the loop has answered a change."""
        for key in _KEYS.findall(keys):
            self._press(key)

    def line(self, width: int) -> Line:
        """The chosen gain with its value, range and unit, what is typed, and what came of the last key."""
        gain = self._gain()
        if gain is None:
            return [(" gains can change from the first tick on", "dim")]
        unit = "" if gain.unit == "1" else f" {gain.unit}"
        value = self._tuner.values[gain.name]
        place = f" {self._chosen + 1}/{len(self._tuner.gains)} "
        line: Line = [(place, "dim"), (gain.name, "bold"), (f" = {value:.6g}{unit}", "bold cyan")]
        line.append((f"  {gain.low:g}..{gain.high:g}  ", "dim"))
        if self._typed:
            line.append((f"{self._typed}_  ", "bold reverse"))
        return [*line, self._said] if self._said[0] else apart(line, [(_HINT, "dim")], width)

    def _gain(self) -> Gain | None:
        gains = self._tuner.gains
        return gains[self._chosen % len(gains)] if gains else None

    def _press(self, key: bytes) -> None:
        gain = self._gain()
        if gain is None:
            return
        if key in _NEXT or key in _BEFORE:
            self._chosen = (self._chosen + (1 if key in _NEXT else -1)) % len(self._tuner.gains)
            self._typed, self._said = "", ("", "")
        elif key in _UP or key in _DOWN:
            self._typed = ""
            self._step(gain, 1.0 if key in _UP else -1.0)
        elif key in _TYPED:
            self._typed = (self._typed + key.decode())[:_LONGEST]
        elif key in _ERASE:
            self._typed = self._typed[:-1]
        elif key == _CANCEL:
            self._typed = ""
        elif key in _ENTER and self._typed:
            typed, self._typed = self._typed, ""
            self._enter(gain, typed)

    def _step(self, gain: Gain, sign: float) -> None:
        """Change it by 5 %, or from 0 by a thousandth of its range, within its range."""
        value = self._tuner.values[gain.name]
        step = _STEP * abs(value) if value else _FROM_ZERO * (gain.high - gain.low)
        self._change(gain, min(max(value + sign * step, gain.low), gain.high))

    def _enter(self, gain: Gain, typed: str) -> None:
        try:
            value = float(typed)
        except ValueError:
            self._said = (f"{typed}: not a number", "bold red")
            return
        self._change(gain, value)

    def _change(self, gain: Gain, value: float) -> None:
        try:
            tick = self._tuner.change(gain.name, value)
        except AbsError as error:
            self._said = (on_one_line(error), "bold red")
        else:
            self._said = (f"from tick {tick}", "green")
