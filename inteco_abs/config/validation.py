"""Checks a merged table against the sections of `model` by pydantic: every mistake with its key, value and range.

Its import takes longer than all others, so only code that reads users' TOML imports it.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

from pydantic import TypeAdapter, ValidationError

from inteco_abs.config import model
from inteco_abs.config.model import (
    WIRING,
    RigConfig,
    Table,
    bare,
    bounds,
    defaults,
    key_types,
    limits,
    section_at,
    section_of,
    type_at,
)
from inteco_abs.errors import ConfigIssue, near_match, shortened
from inteco_abs.quantities import field_meanings, number_hint, other_unit, unit_of

_ADAPTER: Final = TypeAdapter(RigConfig)


def validated(table: Table, issues: list[ConfigIssue]) -> RigConfig | None:
    """The configuration of `table`; None if it has mistakes, which are added to `issues`."""
    config = None
    try:
        config = _ADAPTER.validate_python(table)
    except ValidationError as error:
        issues.extend(_issue(detail) for detail in error.errors())
    issues.extend(_contradictions(table, [issue.path for issue in issues]))
    return config


def json_schema() -> Table:
    """The JSON schema of rig.toml."""
    schema = _ADAPTER.json_schema()
    for name, definition in {**schema["$defs"], RigConfig.__name__: schema}.items():
        section = getattr(model, name)
        for key, meaning in meanings(section).items():  # pydantic finds them, too, but each time it is imported
            definition["properties"][key]["description"] = meaning
        for key, value in defaults(section).items():
            if isinstance(value, list | dict):  # pydantic leaves out defaults made by a factory
                definition["properties"][key]["default"] = value
    return schema


def meanings(section: type[model.Section]) -> dict[str, str]:
    """Meaning of each key of a section: the docstring below it, on one line."""
    found = field_meanings(section)
    return {key: found.get(key, "") for key in key_types(section)}


class _KeyPair(NamedTuple):
    """Two keys with a condition on their values."""

    first: str
    second: str
    fits: Callable[[Any, Any], bool]
    must: str


_OF_LIMIT: Final = "must be at most 0.9 times"  # a tenth for the error of measurement
_PAIRS: Final = (
    _KeyPair("experiment.start_speed_rad_s", "guard.over_speed_rad_s", lambda v, most: v <= 0.9 * most, _OF_LIMIT),
    _KeyPair("experiment.stop_speed_rad_s", "experiment.start_speed_rad_s", operator.lt, "must be below"),
    _KeyPair("estimator.window_s", "loop.rate_hz", lambda s, hz: s * hz > 0.999, "must be at least one period of"),
    _KeyPair("board.brake_pwm", "board.drive_pwm", operator.ne, "must be another PWM channel than"),
    _KeyPair("board.drive_pwm", "board.numbering_pwm", operator.ne, "must be another PWM channel than"),
    _KeyPair("board.brake_pwm", "board.numbering_pwm", operator.ne, "must be another PWM channel than"),
    _KeyPair("board.wheel_encoder", "board.road_encoder", operator.ne, "must be another encoder than"),
    _KeyPair("simulation.brake_pwm", "simulation.drive_pwm", operator.ne, "must be another PWM channel than"),
    _KeyPair("simulation.wheel_encoder", "simulation.road_encoder", operator.ne, "must be another encoder than"),
)


def _contradictions(table: Table, wrong: Collection[str]) -> Iterator[ConfigIssue]:
    """Values that contradict each other; keys in `wrong` have an issue already."""
    sections = key_types(RigConfig)

    def value(path: str) -> Any:
        section, key = path.split(".")
        return table.get(section, {}).get(key, defaults(sections[section])[key])

    board = section_of(table, "board")
    for key in section_of(board, "evidence"):
        if key not in WIRING:
            yield ConfigIssue(
                f"board.evidence.{key}", f"outputs do not depend on {key!r}{near_match(str(key), WIRING)}"
            )
    if board.get("verified_by"):
        missing = [key for key in ("verified_on", "verified_logic") if board.get(key) is None]
        if missing:
            wanted = " and ".join(f"board.{key}" for key in missing)
            yield ConfigIssue(
                "board.verified_by", f"a sign-off needs {wanted} too: the day, and the logic it was made for"
            )
    yield from _orcid_mistakes(section_of(table, "description").get("orcid"))
    yield from _brake_map_mistakes(section_of(section_of(table, "model"), "identified"))
    for pair in _PAIRS:
        if not {pair.first, pair.second, pair.first.partition(".")[0], pair.second.partition(".")[0]} & set(wrong):
            first, second = value(pair.first), value(pair.second)
            if not pair.fits(first, second):
                yield ConfigIssue(pair.first, f"{first!r}: {pair.must} {pair.second} = {second!r}")


def _orcid_mistakes(orcid: Any) -> Iterator[ConfigIssue]:
    """An ORCID iD ends in a check digit, ISO 7064 MOD 11-2 (support.orcid.org, "Structure of the ORCID identifier")."""
    if not isinstance(orcid, str):
        return
    digits = orcid.replace("-", "")
    total = 0
    if _ORCID.fullmatch(orcid):
        for digit in digits[:-1]:
            total = 2 * (total + int(digit))
    if not _ORCID.fullmatch(orcid) or "0123456789X"[(12 - total % 11) % 11] != digits[-1]:
        yield ConfigIssue("description.orcid", f"{orcid!r}: is no ORCID iD; one looks like 0000-0002-1825-0097")


def _brake_map_mistakes(identified: Table) -> Iterator[ConfigIssue]:
    """A brake map needs as many torques as duties, both rising, so that each torque has one duty."""
    keys = ("brake_duties", "brake_torques_nm")
    points = [identified.get(key) for key in keys]
    if points == [None, None]:
        return
    lists = [each if isinstance(each, list) else [] for each in points]
    if len(lists[0]) != len(lists[1]):
        problem = f"{len(lists[0])} values and {len(lists[1])} model.identified.{keys[1]}: each duty needs its torque"
        yield ConfigIssue(f"model.identified.{keys[0]}", problem)
    for key, values in zip(keys, lists, strict=True):
        numbers = [value for value in values if isinstance(value, int | float)]
        if any(following <= value for value, following in pairwise(numbers)):
            yield ConfigIssue(f"model.identified.{key}", f"{shortened(values)}: must rise from value to value")


_ORCID: Final = re.compile(r"([0-9]{4}-){3}[0-9]{3}[0-9X]")
_CEILINGS: Final = {"guard.over_speed_rad_s": "the rig's own limit, which no configuration can raise"}
_NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?", re.IGNORECASE)
_NUMERIC: Final = ("int_", "float_", "finite_")
"""Prefixes of pydantic's error types for values that must be numbers."""


def _issue(detail: Any) -> ConfigIssue:
    """An error of pydantic as dotted key, value and allowed range."""
    location = [part for part in detail["loc"] if part != "[key]"]
    path = ".".join(map(str, location))
    value, kind = detail["input"], detail["type"]
    if kind == "unexpected_keyword_argument":
        section = section_at(location[:-1])
        if len(location) == 1 and (paths := _paths_named(path)):
            return ConfigIssue(path, f"unknown key; did you mean {' or '.join(paths)}?")
        return ConfigIssue(path, f"unknown key{near_match(str(location[-1]), key_types(section) if section else ())}")
    if kind == "missing":
        return ConfigIssue(path, "is missing; a profile normally provides it")
    if kind == "dataclass_type":
        return ConfigIssue(path, f"{shortened(value)}: must be a section, as [{path}] with its keys below")
    ceiling = f" ({_CEILINGS[path]})" if path in _CEILINGS and kind == "less_than_equal" else ""
    return ConfigIssue(path, f"{shortened(value)}: must be {limits(location)}{ceiling}{_meant(location, value, kind)}")


def _paths_named(key: str) -> list[str]:
    """Keys of that name within the sections."""
    inner = ((name, section_at([name])) for name in key_types(RigConfig))
    return [f"{name}.{key}" for name, section in inner if section is not None and key in key_types(section)]


def _meant(location: Sequence[Any], value: object, kind: str) -> str:
    """Hint for a value that is not a number or has another unit; empty without a guess."""
    unit = unit_of(str(location[-1]))
    if isinstance(value, str):
        if not kind.startswith(_NUMERIC):
            return ""
        return "; write it without quotes" if _NUMBER.fullmatch(value) else number_hint(value, unit)
    key_type = type_at(location)
    if bare(key_type) is not float or isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    low, high = bounds(key_type, "ge", "gt"), bounds(key_type, "le", "lt")
    return other_unit(value, unit, low[0], high[0]) if low and high else ""
