"""Conditions on sessions, as `Mk > 3 and outcome = "completed"`, as SQL with parameters.

A condition compares a name with a number or a text: `=`, `!=`, `<`, `<=`, `>`, `>=`, or `contains` for a part of a
text; `and`, `or`, `not` and parentheses join conditions. A name that a session lacks makes its comparison false.
"""

from __future__ import annotations

import json
import re
from typing import Final, NamedTuple

from inteco_abs.errors import ConfigError

_TOKEN: Final = re.compile(
    r"""\s*(?:(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<text>"[^"]*"|'[^']*')
    |(?P<name>[A-Za-z_][\w.]*)|(?P<sign><=|>=|!=|==|=|<|>|\(|\)))""",
    re.VERBOSE,
)
_COMPARISONS: Final = ("=", "==", "!=", "<", "<=", ">", ">=")
_WORDS: Final = ("and", "or", "not", "contains")
_EXAMPLE: Final = """must look like 'Mk > 3 and outcome = "completed"'"""
_DEEPEST: Final = 50


class Condition(NamedTuple):
    """A condition as SQL."""

    sql: str
    """Over a column `facts` with JSON."""
    parameters: list[str | float]
    names: list[str]
    """Names that it compares."""


def parse_condition(text: str) -> Condition:
    """The condition that `text` states. Raises ConfigError with where it is wrong."""
    return _Parser(text).whole()


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._at = self._depth = 0
        self._parameters: list[str | float] = []
        self._names: list[str] = []
        self._kind = self._value = ""
        self._next()

    def whole(self) -> Condition:
        sql = self._any()
        if self._kind:
            raise self._wrong("nothing more can follow here")
        return Condition(sql, self._parameters, self._names)

    def _next(self) -> None:
        rest = self._text[self._at :]
        found = _TOKEN.match(rest)
        if found is None:
            self._kind, self._value = "", ""
            if rest.strip():
                raise self._wrong(f"cannot read {rest.strip()!r}")
            return
        self._at += found.end()
        self._kind, self._value = str(found.lastgroup), found[str(found.lastgroup)]
        if self._kind == "name" and self._value.lower() in _WORDS:
            self._kind, self._value = "word", self._value.lower()

    def _any(self) -> str:
        parts = [self._all()]
        while self._value == "or":
            self._next()
            parts.append(self._all())
        return f"({' OR '.join(parts)})"

    def _all(self) -> str:
        parts = [self._one()]
        while self._value == "and":
            self._next()
            parts.append(self._one())
        return f"({' AND '.join(parts)})"

    def _one(self) -> str:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise self._wrong(f"has more than {_DEEPEST} parts inside each other")
        if self._value == "not":
            self._next()
            sql = f"NOT {self._one()}"
        elif self._value == "(":
            self._next()
            sql = self._any()
            if self._value != ")":
                raise self._wrong("a ) is missing")
            self._next()
        else:
            sql = self._comparison()
        self._depth -= 1
        return sql

    def _comparison(self) -> str:
        if self._kind != "name":
            raise self._wrong("a name is missing")
        self._names.append(self._value)
        self._parameters.append(f"$.{json.dumps(self._value)}")
        self._next()
        sign = self._value
        if sign not in (*_COMPARISONS, "contains"):
            raise self._wrong(f"one of {' '.join(_COMPARISONS)} contains is missing")
        self._next()
        if self._kind not in {"number", "text"}:
            raise self._wrong("a number, or a text in quotes, is missing")
        value: str | float = float(self._value) if self._kind == "number" else self._value[1:-1]
        self._next()
        if sign == "contains":
            self._parameters.append(str(value))
            return "(ifnull(instr(lower(json_extract(facts, ?)), lower(?)), 0) > 0)"
        self._parameters.append(value)
        return f"ifnull(json_extract(facts, ?) {sign} ?, 0)"

    def _wrong(self, problem: str) -> ConfigError:
        here = f"behind {self._text[: self._at].strip()!r}" if self._at else "at its beginning"
        return ConfigError.of("--where", f"{self._text!r}: {problem} {here}; {_EXAMPLE}")
