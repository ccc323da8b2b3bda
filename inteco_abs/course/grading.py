"""Grades a submission: runs it in its own process, compares what was measured with the limits, and makes the table."""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from inteco_abs.course.braking import brake
from inteco_abs.course.confinement import SECRETS
from inteco_abs.course.estimating import estimate
from inteco_abs.course.exercise import Exercise, Kind, Limit, exercises
from inteco_abs.course.identifying import identify
from inteco_abs.course.measured import Draw, Measured, median
from inteco_abs.course.monitoring import watch
from inteco_abs.course.submission import Submission, SubmissionError
from inteco_abs.errors import ConfigError, near_file

__all__ = ["Exercise", "Grade", "Kept", "exercises", "grade", "new_seed"]

_KINDS: Final[Mapping[Kind, Callable[[Exercise, Submission, Draw], Measured]]] = {
    "controller": brake,
    "estimator": estimate,
    "identification": identify,
    "monitor": watch,
}
_SEED_BITS: Final = 60
_MOST_BYTES: Final = 1_000_000
_MOST_NOTES: Final = 3
_SLACK: Final = 1e-12
"""Of a share that is a whole number of cases."""


@dataclass(frozen=True, slots=True)
class Kept:
    """How one limit was kept."""

    limit: Limit
    values: tuple[float, ...]
    """One for each case to which it applies; NaN where the submission has none."""
    cases: tuple[str, ...]

    @property
    def within(self) -> int:
        """Cases that keep it."""
        return sum(value <= self.limit.most for value in self.values)

    @property
    def needed(self) -> int:
        """Cases that must."""
        return math.ceil(self.limit.share * len(self.values) - _SLACK)

    @property
    def passed(self) -> bool:
        """Whether enough cases keep it."""
        return self.within >= self.needed

    @property
    def worst(self) -> int:
        """Place of the largest value, or of the first that is missing."""
        return max(range(len(self.values)), key=lambda i: math.inf if math.isnan(self.values[i]) else self.values[i])

    @property
    def missing(self) -> str:
        """What is missing, and how far; empty if nothing is."""
        if self.passed:
            return ""
        limit, count = self.limit, len(self.values)
        unit = "" if limit.unit == "1" else f" {limit.unit}"
        worst = _number(self.values[self.worst], unit)
        kept = f"kept in {self.within} of {count}, {self.needed} are needed"
        return f"{limit.what}: at most {limit.most:g}{unit}, {kept}; worst: {worst}, {self.cases[self.worst]}"

    def report(self) -> dict[str, Any]:
        """For JSON."""
        known = {"median": median(self.values), "worst": self.values[self.worst]} if self.values else {}
        return {
            "measure": self.limit.measure,
            "what": self.limit.what,
            "unit": self.limit.unit,
            "most": self.limit.most,
            "cases": len(self.values),
            "needed": self.needed,
            "within": self.within,
            "passed": self.passed,
            **{name: value if math.isfinite(value) else None for name, value in known.items()},
            "worst_case": self.cases[self.worst] if self.values else None,
        }


@dataclass(frozen=True, slots=True)
class Grade:
    """Result of one submission."""

    exercise: Exercise
    file: str
    seed: int
    confined: tuple[str, ...] | None
    """What the submission was kept from; None if it was not started."""
    measured: Measured | None
    failure: str
    """Why there is nothing to compare; empty if there is."""
    printed: tuple[str, ...]
    """The last lines that the submission printed."""

    @property
    def kept(self) -> tuple[Kept, ...]:
        """The limits, with what was measured."""
        if self.measured is None:
            return ()
        found = []
        for limit in self.exercise.limits:
            pairs = zip(self.measured.values[limit.measure], self.measured.cases, strict=True)
            known = [(value, case) for value, case in pairs if value is not None]
            found.append(Kept(limit, tuple(value for value, _ in known), tuple(case for _, case in known)))
        return tuple(found)

    @property
    def passed(self) -> bool:
        """Whether all limits are kept."""
        return self.measured is not None and all(each.passed for each in self.kept)

    @property
    def score(self) -> int:
        """Points from 0 to 100, rounded down; also of a submission that does not pass."""
        return 0 if self.measured is None else math.floor(self.measured.score)

    @property
    def safe(self) -> bool:
        """Whether the truth was out of the submission's reach."""
        return self.confined is None or set(SECRETS) <= set(self.confined)

    @property
    def missing(self) -> tuple[str, ...]:
        """What is missing, a line each."""
        if self.failure:
            return (self.failure,)
        return tuple(each.missing for each in self.kept if not each.passed)

    def report(self) -> dict[str, Any]:
        """For JSON."""
        measured = self.measured
        compared = {}
        if measured is not None:
            values = {"own": measured.own, "zero": measured.zero, "hundred": measured.hundred}
            compared = {name: value if math.isfinite(value) else None for name, value in values.items()}
        return {
            "file": self.file,
            "passed": self.passed,
            "score": self.score,
            "failure": self.failure or None,
            "confined": None if self.confined is None else list(self.confined),
            "compared": compared,
            "limits": [each.report() for each in self.kept],
            "missing": list(self.missing),
            "notes": [] if measured is None else list(measured.notes),
        }

    def row(self) -> dict[str, Any]:
        """For a table of many submissions."""
        worst = {each.limit.measure: _number(each.values[each.worst]) for each in self.kept if each.values}
        verdict = {"file": self.file, "exercise": self.exercise.name, "passed": self.passed, "score": self.score}
        return {**verdict, "confined": self.safe, "seed": self.seed, "missing": "; ".join(self.missing), **worst}

    def __rich__(self) -> RenderableType:
        """Table of the limits, what is missing, and the score."""
        body: list[RenderableType] = [self._verdict(), Text()]
        if self.measured is not None:
            body += [self._table(), Text(), Text(self._score(), "dim")]
        body += [Text(f"missing: {each}", "yellow") for each in self.missing]
        notes = () if self.measured is None else self.measured.notes
        body += [Text(note) for note in notes[:_MOST_NOTES]]
        if len(notes) > _MOST_NOTES:
            body.append(Text(f"and {len(notes) - _MOST_NOTES} more"))
        body += [Text(f"it printed: {line}", "dim") for line in self.printed[-_MOST_NOTES:]]
        body.append(Text(f"seed {self.seed}: --seed {self.seed} draws the same again", "dim"))
        return Panel(Group(*body), title=self.exercise.title, subtitle=self.file, expand=False)

    def _verdict(self) -> Text:
        word, style = ("PASSED", "bold green") if self.passed else ("NOT PASSED", "bold red")
        return Text.assemble((word, style), f"  score {self.score} of 100")

    def _score(self) -> str:
        if self.measured is None:
            return ""
        score, measured = self.exercise.score, self.measured
        names = {limit.measure: limit.what for limit in self.exercise.limits}
        return (
            f"score: {names.get(score.measure, score.measure)}, {_number(measured.own)}; "
            f"0 is {_named(score.zero, measured.zero)}, 100 is {_named(score.hundred, measured.hundred)}"
        )

    def _table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        table.show_header = True
        table.add_column(Text("measure", "dim"), overflow="fold")
        for head in ("at most", "median", "worst", "kept in", "needed"):
            table.add_column(Text(head, "dim"), justify="right", no_wrap=True)
        for each in self.kept:
            limit, count = each.limit, len(each.values)
            what = limit.what if limit.unit == "1" else f"{limit.what} [{limit.unit}]"
            values = (median(each.values), each.values[each.worst]) if count else (math.nan, math.nan)
            cells = (f"{limit.most:g}", *map(_number, values), f"{each.within} of {count}", str(each.needed))
            table.add_row(Text(what), *(Text(cell, "" if each.passed else "yellow") for cell in cells))
        return table


def _number(value: float, unit: str = "") -> str:
    return f"{value:.3g}{unit}" if math.isfinite(value) else "none"


def _named(law: Mapping[str, Any] | float, value: float) -> str:
    if isinstance(law, float):
        return _number(value)
    name = "the oracle" if law.get("oracle") else law.get("controller") or law["estimator"]
    return f"{name} ({_number(value)})"


def new_seed() -> int:
    """A seed that cannot be guessed."""
    return secrets.randbits(_SEED_BITS)


def grade(exercise: Exercise, file: Path, seed: int) -> Grade:
    """Grade one file. Raises ConfigError for one that cannot be read, and AbsError without the extra `lab`."""
    source = _read(file)
    measured, failure, submission = None, "", None
    try:
        given = file.name, source.decode(), exercise.asks, exercise.may_import, exercise.cpu_s
        submission = Submission(*given)
        with submission:
            measured = _KINDS[exercise.kind](exercise, submission, Draw(exercise, seed))
    except UnicodeDecodeError:
        failure = "not a text file in UTF-8"
    except SubmissionError as error:
        failure = str(error)
    confined = None if submission is None else submission.confined
    printed = () if submission is None else tuple(submission.printed)
    return Grade(exercise, str(file), seed, confined, measured, failure, printed)


def _read(file: Path) -> bytes:
    try:
        if not file.is_file() and file.exists():
            raise ConfigError.of("FILE", f"{file}: not a regular file")
        data = file.read_bytes()
    except OSError as error:
        raise ConfigError.of("FILE", f"{file}: cannot be read: {error.strerror}{near_file(file)}") from error
    if len(data) > _MOST_BYTES:
        raise ConfigError.of("FILE", f"{file}: {len(data)} bytes: must be at most {_MOST_BYTES}")
    return data
