"""What a check looks at, and what it has to say."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Final, NamedTuple

NOT_KNOWN: Final = "not known on this system"


class Rating(StrEnum):
    """How good something is for the 2 kHz loop."""

    GREEN = "green"
    """As it should be."""
    AMBER = "amber"
    """It works, but a tick may come late now and then; or nobody can tell."""
    RED = "red"
    """The loop will not hold its rate, or does not reach the board or the disk at all."""


_FROM_BEST: Final = tuple(Rating)


class Judgement(NamedTuple):
    """What a check says."""

    verdict: Rating
    found: str
    """What was seen, with its unit."""
    fix: str = ""
    """What to do about it; empty when green."""


class CheckResult(NamedTuple):
    """A judgement and what it is about."""

    name: str
    verdict: Rating
    found: str
    fix: str = ""


def green(found: str) -> Judgement:
    """As it should be."""
    return Judgement(Rating.GREEN, found)


def amber(found: str, fix: str) -> Judgement:
    """It works, not always in time; or nobody can tell."""
    return Judgement(Rating.AMBER, found, fix)


def red(found: str, fix: str) -> Judgement:
    """It will not do."""
    return Judgement(Rating.RED, found, fix)


def worst(judged: Iterable[CheckResult | Judgement]) -> Rating:
    """The worst verdict; green when there is none."""
    return max((one.verdict for one in judged), key=_FROM_BEST.index, default=Rating.GREEN)


def together(parts: Sequence[Judgement]) -> Judgement:
    """One judgement of several things of a kind: the worst verdict, everything seen, each fix once."""
    fixes = dict.fromkeys(part.fix for part in parts if part.fix)
    return Judgement(worst(parts), "; ".join(part.found for part in parts), "; ".join(fixes))


def as_facts(findings: Iterable[CheckResult]) -> dict[str, str]:
    """Findings as a session's metadata, such as `"clock_source": "green: tsc"`."""
    return {
        finding.name.lower().replace(" ", "_").replace("-", "_"): f"{finding.verdict}: {finding.found}"
        for finding in findings
    }


class Computer:
    """The files in which a system tells about itself, below `root`; elsewhere than `/` for the tests."""

    def __init__(self, root: Path = Path("/")) -> None:
        self.root = root

    def text(self, path: str) -> str:
        """Content of a file without the white space around it. Raises OSError if it cannot be read."""
        return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()

    def text_or(self, path: str, missing: str) -> str:
        """Content of a file, or `missing`."""
        try:
            return self.text(path)
        except OSError:
            return missing

    def bytes_of(self, path: str, most: int) -> bytes:
        """The first bytes of a file, `most` at most; none if it cannot be read."""
        try:
            with (self.root / path).open("rb") as file:
                return file.read(most)
        except OSError:
            return b""

    def matching(self, pattern: str) -> list[str]:
        """Paths that match, in order; none if there are no such folders."""
        return sorted(str(path.relative_to(self.root)) for path in self.root.glob(pattern))

    def exists(self, path: str) -> bool:
        """Whether there is such a file or folder."""
        return (self.root / path).exists()

    def may_write(self, path: str) -> bool:
        """Whether this user may; the file is not opened."""
        return os.access(self.root / path, os.W_OK)


Check = Callable[[Computer], Judgement]
"""Looks at one thing. Raises OSError, ValueError or LookupError where the system does not tell, or not that way."""


def look(computer: Computer, checks: Mapping[str, Check]) -> list[CheckResult]:
    """Run each check; what the system does not tell is not known, never an error."""
    findings = []
    for name, check in checks.items():
        try:
            judgement = check(computer)
        except (OSError, ValueError, LookupError):
            judgement = amber(NOT_KNOWN, "the checks read /proc and /sys of Linux")
        findings.append(CheckResult(name, *judgement))
    return findings
