"""Checks of the computer and their results."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Final, NamedTuple

NOT_KNOWN: Final = "not known on this system"


class Rating(StrEnum):
    """How well something suits the 2 kHz loop."""

    GREEN = "green"
    """As it should be."""
    AMBER = "amber"
    """It works, but a tick may be late now and then; or it is not known."""
    RED = "red"
    """The loop cannot hold its rate, or cannot reach the board or the disk."""


_FROM_BEST: Final = tuple(Rating)


class Judgement(NamedTuple):
    """Result of a check, without its name."""

    verdict: Rating
    found: str
    """What was found, with its unit."""
    fix: str = ""
    """What to do; empty when green."""


class CheckResult(NamedTuple):
    """Result of a check, with its name."""

    name: str
    verdict: Rating
    found: str
    fix: str = ""


def green(found: str) -> Judgement:
    """Return a green judgement."""
    return Judgement(Rating.GREEN, found)


def amber(found: str, fix: str) -> Judgement:
    """Return an amber judgement."""
    return Judgement(Rating.AMBER, found, fix)


def red(found: str, fix: str) -> Judgement:
    """Return a red judgement."""
    return Judgement(Rating.RED, found, fix)


def worst(judged: Iterable[CheckResult | Judgement]) -> Rating:
    """Return the worst rating; green for none."""
    return max((one.verdict for one in judged), key=_FROM_BEST.index, default=Rating.GREEN)


def together(parts: Sequence[Judgement]) -> Judgement:
    """Join several judgements: the worst rating, everything found, each fix once."""
    fixes = dict.fromkeys(part.fix for part in parts if part.fix)
    return Judgement(worst(parts), "; ".join(part.found for part in parts), "; ".join(fixes))


def as_facts(findings: Iterable[CheckResult]) -> dict[str, str]:
    """Return results as a session's metadata, such as `"clock_source": "green: tsc"`."""
    return {
        finding.name.lower().replace(" ", "_").replace("-", "_"): f"{finding.verdict}: {finding.found}"
        for finding in findings
    }


class Computer:
    """The files in which a system describes itself, below `root`; tests use another root than `/`."""

    def __init__(self, root: Path = Path("/")) -> None:
        self.root = root

    def text(self, path: str) -> str:
        """Return a file's content, stripped. Raises OSError if it cannot be read."""
        return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()

    def text_or(self, path: str, missing: str) -> str:
        """Return a file's content, or `missing`."""
        try:
            return self.text(path)
        except OSError:
            return missing

    def bytes_of(self, path: str, most: int) -> bytes:
        """Return the first bytes of a file, `most` at most; none if it cannot be read."""
        try:
            with (self.root / path).open("rb") as file:
                return file.read(most)
        except OSError:
            return b""

    def matching(self, pattern: str) -> list[str]:
        """Return the matching paths, sorted."""
        return sorted(str(path.relative_to(self.root)) for path in self.root.glob(pattern))

    def exists(self, path: str) -> bool:
        """Return whether the file or folder exists."""
        return (self.root / path).exists()

    def may_write(self, path: str) -> bool:
        """Return whether this user may write the file, without opening it."""
        return os.access(self.root / path, os.W_OK)


Check = Callable[[Computer], Judgement]
"""Checks one thing. Raises OSError, ValueError or LookupError if the system does not provide the facts."""


def look(computer: Computer, checks: Mapping[str, Check]) -> list[CheckResult]:
    """Run all checks; a check without facts is amber, never an error."""
    findings = []
    for name, check in checks.items():
        try:
            judgement = check(computer)
        except (OSError, ValueError, LookupError):
            judgement = amber(NOT_KNOWN, "the checks read /proc and /sys of Linux")
        findings.append(CheckResult(name, *judgement))
    return findings
