"""What a population changes of a rig: one rule for each number, which each draw follows by itself."""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Final, NamedTuple

from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.rng import WORD, SplitMix64, mixed
from inteco_abs.rig.variation import EncoderVariation, RigVariation

LAG: Final = "brake_lag_s"
"""In [rig], for c31: the brake's lag in s, of which 0 is none."""
_ENCODERS: Final = ("wheel_encoder", "road_encoder")
_TABLES: Final[dict[str, type[Any]]] = {
    "rig": RigVariation,
    "parameters": RigParameters,
    **dict.fromkeys((*_ENCODERS, "encoders"), EncoderVariation),
}
_NOT_DRAWN: Final = {"parameters", *_ENCODERS, "seed"}
_SIGNED: Final = {"w1", "w2", "w3", "b2"}
"""Parameters that may be negative; all others are above 0."""
_WAYS: Final = {"value", "range", "factor", "any"}
_LONGEST_LAG_S: Final = 1.0
_MOST: Final = 100.0
"""Times the base's: beyond, a number is a slip of the unit."""


class Rule(NamedTuple):
    """How one field is drawn: a number of low..high, times the base's where it is a factor, or one of the choices."""

    table: str
    name: str
    low: float = 0.0
    high: float = 0.0
    factor: bool = False
    choices: tuple[str, ...] = ()
    share: float = 1.0
    """Share of the draws that have it; the others keep the base's."""

    def drawn(self, rig: RigVariation, seed: int) -> Any:
        """The field's value, from the seed and the field's name alone; None for the rig's own."""
        generator = SplitMix64(mixed(seed ^ _hash(f"{self.table}.{self.name}")))
        if generator.uniform(0.0, 1.0) >= self.share:
            return None
        place = generator.uniform(0.0, 1.0)
        if self.choices:
            return self.choices[math.floor(place * len(self.choices))]
        own = self._of(rig)
        whole = isinstance(own, int)
        number = self.low + (self.high - self.low + whole) * place
        if self.factor:
            number *= own
        return math.floor(number) if whole else number

    def require_possible(self, base: RigVariation) -> None:
        """Raise ValueError if an end of the range cannot be."""
        own = self._of(base)
        for end in self.choices or (self.low, self.high):
            value: Any = end
            if isinstance(own, str) != isinstance(end, str) or (isinstance(own, str) and self.factor):
                raise ValueError(f"{end!r}: must be {'a text' if isinstance(own, str) else 'a number'}")
            if isinstance(end, str):
                pass
            elif isinstance(own, int):
                if self.factor or end != math.floor(end):
                    raise ValueError(f"{end!r}: must be a whole number")
                value = int(end)
            elif self.factor:
                value = end * own
            if self.table == "parameters" and self.name not in _SIGNED and not 0.0 < value <= _MOST * own:
                raise ValueError(f"{end!r}: must be above 0, and at most {_MOST:g} times the base's {own!r}")
            if self.name == LAG and not 0.0 <= value <= _LONGEST_LAG_S:
                raise ValueError(f"{end!r}: must be in 0..{_LONGEST_LAG_S:g} s")
            changed(base, [(self, value)])

    def _of(self, rig: RigVariation) -> Any:
        if self.name == LAG:
            return 1.0 / rig.parameters.c31
        return getattr(rig if self.table == "rig" else getattr(rig, self.table), self.name)


def follow(rules: Sequence[Rule], rig: RigVariation, seed: int) -> RigVariation:
    """The rig with all that the rules draw for a seed; raises ValueError where they make an impossible one."""
    return changed(rig, [(rule, value) for rule in rules if (value := rule.drawn(rig, seed)) is not None])


def changed(rig: RigVariation, values: Sequence[tuple[Rule, Any]]) -> RigVariation:
    """The rig with these values in the rules' fields."""
    own: dict[str, dict[str, Any]] = {}
    for rule, value in values:
        if rule.name == LAG:
            own.setdefault("parameters", {})["c31"] = 1.0 / value if value else math.inf
        else:
            own.setdefault(rule.table, {})[rule.name] = value
    tables = {name: replace(getattr(rig, name), **new) for name, new in own.items() if name != "rig"}
    return replace(rig, **tables, **own.get("rig", {}))


def parse_rules(tables: Mapping[str, Any], base: RigVariation) -> tuple[Rule, ...]:
    """The rules of the tables of a population, which are tried on a rig of its base.

    A value is a number or a string; [LOW, HIGH] for an even spread; [TEXT, ...] for one of them; or a table with one of
    `value`, `range`, `factor` (of the base's) and `any`, and with `share`, the share of the draws that have it.
    Raises ValueError, which names the key.
    """
    rules = []
    for table, keys in tables.items():
        if table not in _TABLES:
            raise ValueError(f"{table}: must be base or one of the tables {', '.join(_TABLES)}")
        if not isinstance(keys, dict):
            raise ValueError(  # noqa: TRY004  it is the user's text that is wrong
                f"{table}: must be a table, as [{table}]"
            )
        for name, said in keys.items():
            try:
                rules += [_rule(each, name, said, base) for each in _expanded(table)]
            except ValueError as error:
                raise ValueError(f"{table}.{name}: {error}") from error
    _require_consistent(rules, base)
    return tuple(rules)


def _require_consistent(rules: Sequence[Rule], base: RigVariation) -> None:
    """Raise ValueError for rules of which each is possible, but not both."""
    named = {(rule.table, rule.name): rule for rule in rules}
    if {("rig", LAG), ("parameters", "c31")} <= named.keys():
        raise ValueError(f"rig.{LAG} and parameters.c31: both are the brake's lag; give one of them")
    counts = [named.get((each, "counts_per_turn")) for each in _ENCODERS]
    wheel, road = (
        getattr(base, each).counts_per_turn if rule is None else rule.low
        for each, rule in zip(_ENCODERS, counts, strict=True)
    )
    if wheel != road:
        raise ValueError(f"counts_per_turn: {wheel:g} and {road:g}: must be the same; write it into [encoders]")


def _expanded(table: str) -> tuple[str, ...]:
    return _ENCODERS if table == "encoders" else (table,)


def _rule(table: str, name: str, said: object, base: RigVariation) -> Rule:
    known = {field.name for field in fields(_TABLES[table])} - _NOT_DRAWN | ({LAG} if table == "rig" else set())
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        raise ValueError("unknown key" + (f"; did you mean {near[0]}?" if near else ""))
    way, value, share = _parsed(said)
    rule = Rule(table, name, share=share)
    if way == "any":
        rule = rule._replace(choices=value)
    else:
        low, high = value
        rule = rule._replace(low=low, high=high, factor=way == "factor")
    if name == "counts_per_turn" and (rule.low != rule.high or share < 1.0):
        raise ValueError("must be one number: all rigs of a population have the same discs")
    rule.require_possible(base)
    return rule


def _parsed(said: object) -> tuple[str, Any, float]:
    """Way, value as a pair of numbers or as texts, and share."""
    share: Any = 1.0
    way = "value"
    if isinstance(said, dict):
        ways = [key for key in said if key in _WAYS]
        strange = [key for key in said if key not in {*_WAYS, "share"}]
        if len(ways) != 1 or strange:
            raise ValueError(f"{said!r}: must have one of {', '.join(sorted(_WAYS))}, and may have share")
        way, share = ways[0], said.get("share", 1.0)
        said = said[way]
    if not (_is_number(share) and 0.0 < share <= 1.0):
        raise ValueError(f"share = {share!r}: must be above 0, and at most 1")
    if isinstance(said, str) and way in {"value", "any"}:
        return "any", (said,), share
    if isinstance(said, list) and said and all(isinstance(one, str) for one in said) and way in {"value", "any"}:
        return "any", tuple(said), share
    if _is_number(said) and way in {"value", "factor"}:
        return way, (said, said), share
    if isinstance(said, list) and len(said) == 2 and all(map(_is_number, said)) and way != "any":
        if not said[0] <= said[1]:
            raise ValueError(f"{said!r}: the lower end comes first")
        return way, tuple(said), share
    raise ValueError(f"{said!r}: must be a number, a text, [LOW, HIGH] or [TEXT, ...]")


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max  # an int may be beyond all floats


def _hash(text: str) -> int:
    """FNV-1a of 64 bits."""
    found = 0xCBF29CE484222325
    for byte in text.encode():
        found = (found ^ byte) * 0x100000001B3 & WORD
    return found
