"""Errors, written for the person at the rig: what is wrong, the value, what is allowed, what to do next.

AbsError
├── ConfigError    the command line or rig.toml alone is wrong; nothing was touched
├── BoardError     the board is missing, unknown, refuses, or cannot be made safe
│   ├── LinkError      an exchange failed: no answer, short, stale or not what was sent
│   ├── UnsafeError    SAFE could not be confirmed
│   └── ReadOnlyError  outputs are off: the profile does not know or trust this board
├── SessionError   a session file cannot be written or used
├── CaptureError   a capture of the wire cannot be written, imported or used
└── ProbeError     a step of the commissioning walk has not come out well
    └── Stopped        the person has left the walk
"""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

_LONGEST: Final = 2000
"""Characters of a foreign error's text that are worth keeping."""


class AbsError(Exception):
    """Anything the person at the rig can act on. `exit_code` is what the command ends with."""

    exit_code = 1


class Mistake(NamedTuple):
    """One thing wrong in a configuration: dotted key, and what is wrong with its value."""

    path: str
    problem: str

    @property
    def typed(self) -> bool:
        """Whether it names an option or an argument, not a key."""
        return self.path.startswith("--") or self.path.isupper()


class ConfigError(AbsError):
    """Wrong configuration or usage; `mistakes` has all of them."""

    exit_code = 2

    def __init__(self, mistakes: Sequence[Mistake]) -> None:
        self.mistakes = tuple(mistakes)
        lines = [f"  {mistake.path}: {mistake.problem}" for mistake in self.mistakes]
        count = f"{len(lines)} mistakes" if len(lines) > 1 else "a mistake"
        place = "command line" if all(mistake.typed for mistake in self.mistakes) else "configuration"
        super().__init__("\n".join([f"the {place} has {count}; nothing was started:", *lines]))

    def __reduce__(self) -> tuple[type[ConfigError], tuple[tuple[Mistake, ...]]]:
        """Made from its mistakes again, not from its text, where another process has raised it."""
        return type(self), (self.mistakes,)


class BoardError(AbsError):
    """The board is missing, unknown, refuses, or cannot be made safe."""


class LinkError(BoardError):
    """One exchange with the board failed."""


class UnsafeError(BoardError):
    """SAFE could not be confirmed: motor power may still be on."""

    exit_code = 5


class ReadOnlyError(BoardError):
    """The board is open for reading only, and something asked for an output."""


class SessionError(AbsError):
    """A session file cannot be written, read or replayed."""


class CaptureError(AbsError):
    """A capture of the wire cannot be written, imported, read or replayed."""


class ProbeError(AbsError):
    """A step of the commissioning walk has not come out well; the draft stays as it was before the step."""


class Stopped(ProbeError):  # noqa: N818  leaving is nothing wrong
    """The person has left the walk, which can go on later."""

    exit_code = 130


def refusals(conditions: Iterable[Callable[[], object]]) -> list[AbsError]:
    """Everything that conditions have to say, each of which raises what is wrong; empty if all of them hold."""
    found = []
    for condition in conditions:
        try:
            condition()
        except AbsError as error:
            found.append(error)
    return found


def near_match(word: str, known: Iterable[str]) -> str:
    """`"; did you mean X?"`, or the known words when none is close: the tail of a message about a wrong name."""
    known = sorted(known)
    near = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"


def in_a_line(error: AbsError) -> str:
    """An error's text for the middle of a sentence."""
    if isinstance(error, ConfigError):
        return "; ".join(mistake.problem for mistake in error.mistakes)
    return str(error)


def in_words(error: BaseException) -> str:
    """Type, text and place of an error, for people who wrote the code that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    text = str(error)
    return f"{type(error).__name__}: {text if len(text) <= _LONGEST else text[:_LONGEST] + '...'}{place}"
