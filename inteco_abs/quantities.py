"""Name, unit and meaning of numbers; hints for those with a comma or in another unit; numbers for JSON and tables."""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Iterable
from itertools import pairwise
from typing import Any, Final, NamedTuple, cast

_NUMBER: Final = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_WITH_COMMA: Final = re.compile(r"([+-]?\d+),(\d+)\s*[^\d,]*")
_WITH_UNIT: Final = re.compile(rf"({_NUMBER})\s*([^\W\d_].*|%)")
_FACTORS: Final[dict[str, dict[str, float]]] = {
    "rad/s": {"rpm": math.pi / 30.0, "1/min": math.pi / 30.0},
    "s": {"ms": 1e-3, "us": 1e-6, "min": 60.0},
    "Hz": {"kHz": 1e3},
    "": {"%": 1e-2},
}
"""Conversion factors by the wanted unit; a share has the unit ""."""
_FAR: Final = 3.0
"""Factor beyond a limit from which another unit is likelier than a number that is too large."""
_LARGEST: Final = 1e12
"""Larger numbers are in no unit."""
_ENDINGS: Final = {"_rad_s": "rad/s", "_per_s": "1/s", "_hz": "Hz", "_nm": "N m", "_s": "s"}


class Quantity(NamedTuple):
    """What a number is."""

    name: str
    unit: str = ""
    """As in UCUM, such as `1/s` or `N.m`; `1` has no dimension, empty is unknown, or a text."""
    meaning: str = ""


def quantities(declared: Iterable[Quantity | str | Iterable[str]]) -> tuple[Quantity, ...]:
    """Quantities that were declared as such or as plain names, or come from JSON."""
    return tuple(Quantity(each) if isinstance(each, str) else Quantity(*each) for each in declared)


def finite(value: float) -> float | None:
    """`value` for JSON: None for NaN and the infinities."""
    return float(value) if math.isfinite(value) else None


def shown(value: float | None, form: str = ".3g") -> str:
    """`value` for a table, in the given format; a dash for None."""
    return "-" if value is None else format(value, form)


def unit_of(key: str) -> str:
    """Unit at the end of a key's name, as in `rate_hz`; empty if there is none."""
    return next((unit for ending, unit in _ENDINGS.items() if key.endswith(ending)), "")


def number_hint(text: str, unit: str = "") -> str:
    """Correction of a text that is not a number, as the tail of a message; empty if there is none."""
    text = text.strip()
    comma = _WITH_COMMA.fullmatch(text)
    if comma is not None:
        whole = f" or {comma[1]}{comma[2]}" if len(comma[2]) == 3 else ""
        return f"; a comma is not a decimal point: write {comma[1]}.{comma[2]}{whole}"
    found = _WITH_UNIT.fullmatch(text)
    if found is None:
        return ""
    factor = _FACTORS.get(unit, {}).get(found[2])
    if factor is not None:
        return f"; write the number alone{_in(unit)}: {float(found[1]) * factor:.4g}"
    without = f"{_in(unit)}, without {found[2]!r}" if found[2] != unit else ""
    return f"; write the number alone{without}"


def other_unit(value: float, unit: str, low: float, high: float) -> str:
    """Likely unit of a number far outside `low`..`high`, as the tail of a message; empty if there is none.

    A share is taken as per cent only if its limit is 1.
    """
    if low / _FAR <= value <= high * _FAR or not abs(value) <= _LARGEST or (not unit and high > 1.0):
        return ""
    for name, factor in _FACTORS.get(unit, {}).items():
        if low <= value * factor <= high and factor < 1.0:
            return f"; looks like {name}: {value:.4g} {name} is {value * factor:.4g} {unit}".rstrip()
    if unit == "Hz" and value > 0.0:
        for name, meant in (("kHz", value * 1e3), ("a period in s", 1.0 / value)):
            if low <= meant <= high:
                return f"; looks like {name}: that is {meant:.4g} Hz"
    return ""


def _in(unit: str) -> str:
    return f" in {unit}" if unit else ""


def field_meanings(kind: type[Any]) -> dict[str, str]:
    """The docstring below each field of a class, by name and on one line, from its source."""
    body = cast(ast.ClassDef, ast.parse(inspect.getsource(kind)).body[0]).body
    found = {}
    for field, text in pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            found[ast.unparse(field.target)] = " ".join(ast.literal_eval(text.value).split())
    return found
