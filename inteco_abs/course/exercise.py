"""The exercises: a folder each, with its record and its starting file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

Kind = Literal["controller", "estimator", "identification", "monitor"]
_FOLDER: Final = Path(__file__).with_name("exercises")
_ORDER: Final = ("pi", "reaching-law", "estimator", "identification", "faults", "robust-law")


@dataclass(frozen=True, slots=True)
class Limit:
    """What one measure of a submission must keep."""

    measure: str
    what: str
    """In words, for the table."""
    unit: str
    """As in UCUM; `1` for a number without a dimension."""
    most: float
    """Largest value that passes."""
    share: float = 1.0
    """Share of the cases that must keep it."""


@dataclass(frozen=True, slots=True)
class Score:
    """The measure that the score compares: 0 for what `zero` reaches, 100 for `hundred`, on a logarithmic scale."""

    measure: str
    zero: Mapping[str, Any] | float
    """A law or an estimator, on the same cases, or a value."""
    hundred: Mapping[str, Any] | float


@dataclass(frozen=True, slots=True)
class Exercise:
    """One exercise."""

    name: str
    title: str
    kind: Kind
    asks: str
    """Class or function that the file must have."""
    may_import: tuple[str, ...]
    """What the file may import from this package."""
    rigs: tuple[str, str]
    """Population of its rigs, by name, and its text if it is not shipped."""
    cases: int
    """Rigs, or recordings, of one grading."""
    settings: tuple[str, ...]
    """KEY=VALUE each, of the configuration of its stops."""
    cpu_s: int
    """Computing time of a submission."""
    limits: tuple[Limit, ...]
    score: Score

    @property
    def start(self) -> str:
        """The starting file."""
        return (_FOLDER / self.name / "start.py").read_text(encoding="utf-8")

    @property
    def task(self) -> str:
        """What a file needs, and what it must keep, in lines."""
        allowed = ", ".join(self.may_import)
        of = "recordings of rigs" if self.kind in {"estimator", "monitor"} else "rigs"
        lines = [
            f"{self.name}: {self.title}; {self.page}",
            f"The file has {self.asks}, and may import from this package {allowed}.",
            f"It may compute for {self.cpu_s} s. It is judged on {self.cases} {of} drawn from {self.rigs[0]}:",
        ]
        for limit in self.limits:
            unit = "" if limit.unit == "1" else f" {limit.unit}"
            share = "in all" if limit.share == 1.0 else f"in {100.0 * limit.share:g} %"
            lines.append(f"  {limit.what}: at most {limit.most:g}{unit} {share}")
        return "\n".join(lines)

    @property
    def page(self) -> str:
        """The page in the documentation."""
        return f"docs/course/{self.name}.md"


@cache
def exercises() -> Mapping[str, Exercise]:
    """All by name, in the order of the course."""
    return {name: _read(name) for name in _ORDER}


def _own_rigs(name: str) -> tuple[str, str]:
    file = _FOLDER / name / "rigs.toml"
    return file.name, file.read_text(encoding="utf-8")


def _read(name: str) -> Exercise:
    table = tomllib.loads((_FOLDER / name / "exercise.toml").read_text(encoding="utf-8"))
    return Exercise(
        name=name,
        title=table["title"],
        kind=table["kind"],
        asks=table["asks"],
        may_import=tuple(table["may_import"]),
        rigs=(table["population"], "") if "population" in table else _own_rigs(name),
        cases=table["cases"],
        settings=tuple(table.get("settings", ())),
        cpu_s=table["cpu_s"],
        limits=tuple(Limit(**limit) for limit in table["limits"]),
        score=Score(**table["score"]),
    )
