"""How the verbs `controllers` and `estimators` list and describe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from inteco_abs.cli.terminal import print_json, say
from inteco_abs.format import INTERNALS

if TYPE_CHECKING:
    from inteco_abs.control import Gain, Parameter
    from inteco_abs.quantities import Quantity

_NAME_COLUMNS: Final = 19
"""Width of the column of names, that of the longest name that ships."""


class Description(NamedTuple):
    """Everything about a controller or an estimator."""

    name: str
    text: str
    numbers: Sequence[Gain | Parameter]
    internals: Sequence[Quantity] = ()
    estimator: str = ""


def print_description(one: Description, toml: Mapping[str, Any], *, as_json: bool) -> None:
    import tomli_w

    lines = tomli_w.dumps(toml)
    if as_json:
        numbers = [each._asdict() for each in one.numbers]
        internals = [each.name for each in one.internals]
        facts = {"name": one.name, "text": one.text, "numbers": numbers, "internals": internals, "toml": lines}
        print_json({"schema_version": 1, **facts, "estimator": one.estimator or None})
        return
    say(f"{one.name}\n\n{one.text}\n")
    if one.estimator:
        say(f"works with the estimator {one.estimator} only, which is its default\n")
    _print_numbers(one.numbers, indent=2)
    if not one.numbers:
        say("  nothing to set")
    for column, each in zip(INTERNALS, one.internals, strict=False):
        unit = "" if each.unit in {"", "1"} else f" in {each.unit}"
        say(f"\n{column} in a session is {each.name}{unit}{f': {each.meaning}' if each.meaning else ''}")
    say(f"\nin rig.toml, with the defaults:\n\n{lines.rstrip()}" if lines else "")


def print_line(name: str, text: str, package: str, numbers: Sequence[Gain | Parameter]) -> None:
    """One controller or estimator in a list, with its gains or parameters."""
    say(f"{name:{_NAME_COLUMNS}} {text}{f' [{package}]' if package else ''}")
    _print_numbers(numbers)


def print_broken(broken: Sequence[Mapping[str, str]]) -> None:
    """Print the parts of installed packages that cannot be loaded."""
    for each in broken:
        say(f"{each['name']:{_NAME_COLUMNS}} broken: {each['problem']}")


def _print_numbers(numbers: Sequence[Gain | Parameter], indent: int = _NAME_COLUMNS + 3) -> None:
    """One line each: name, default, range, unit, meaning."""
    values = [f"{each.name} = {each.default:g}" for each in numbers]
    width = max(map(len, ["", *values]))
    for value, each in zip(values, numbers, strict=True):
        unit = "" if each.unit == "1" else f" {each.unit}"
        say(f"{'':{indent}}{value:{width}}  {each.low:g}..{each.high:g}{unit}: {each.meaning}")


def docstring(kind: type) -> str:
    import inspect

    return inspect.getdoc(kind) or "no description"


def summary(kind: type) -> str:
    """First sentence of a class's docstring."""
    return (kind.__doc__ or "no description").strip().partition("\n")[0].rstrip(".")
