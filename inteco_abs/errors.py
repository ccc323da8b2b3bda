"""Errors, written for the person at the rig: what is wrong, the value, the allowed range, the next step.

AbsError
├── ConfigError    the command line or rig.toml alone is wrong; nothing was touched
│   └── ArgumentError  the same of a function's arguments
├── BoardError     the board is missing, unknown, refuses, or cannot be made safe
│   ├── LinkError      an exchange failed: no answer, short, stale or not what was sent
│   ├── UnsafeError    SAFE could not be confirmed
│   └── ReadOnlyError  outputs are off: the profile does not know or trust this board
├── ControllerError  a user's controller has failed in its own process
├── SessionError   a session file cannot be written or used
├── CaptureError   a capture of the wire cannot be written, imported or used
└── CommissioningError  a step of the commissioning failed
    ├── AnswerError    the operator's answer was not one of those asked for
    └── Stopped        the operator left the commissioning
"""

from __future__ import annotations

import difflib
import errno
import re
import traceback
from collections.abc import Callable, Iterable, Sequence
from datetime import date, time
from pathlib import Path
from typing import Final, NamedTuple, Self

_LONGEST_VALUE: Final = 60
_LONGEST: Final = 2000
"""Characters that are kept of another library's error."""
_PLACE: Final = re.compile(r".+, line \d+")
"""A note that `line_of` made."""
_ROOM: Final = "make room there, or name another place"
_ELSEWHERE: Final = "name another place, where you may write"
_TO_DO: Final = {
    errno.ENOSPC: _ROOM,
    errno.EDQUOT: _ROOM,
    errno.EFBIG: _ROOM,
    errno.EACCES: _ELSEWHERE,
    errno.EPERM: _ELSEWHERE,
    errno.EROFS: _ELSEWHERE,
    errno.ENOENT: "create its folder first, or name another place",
    errno.ENOTDIR: "name another place",
    errno.EISDIR: "name a file",
    errno.EEXIST: "choose another name",
    errno.ENAMETOOLONG: "choose a shorter name",
}
"""By errno: what to do when a file cannot be written."""
_ALIKE: Final = 0.65
"""Least likeness of a word and what it was meant to be: of three letters, one may be another."""
_ALIKE_FILES: Final = 0.75
"""The same for names of files, which may be anything: of four letters, two may be in the wrong order."""
_SCREEN_COLUMNS: Final = 80
_SCREEN_LINES: Final = 20
"""Lines of a screen of 24 for the mistakes; the rest is for the text around them."""


class AbsError(Exception):
    """Anything the person at the rig can act on; commands end with its `exit_code`."""

    exit_code = 1


class ConfigIssue(NamedTuple):
    """One thing wrong in a configuration: dotted key, what is wrong with its value, and the file and line it is in."""

    path: str
    problem: str
    place: str = ""

    def __str__(self) -> str:
        where = f" ({self.place})" if self.place else ""
        return f"{self.path}{where}: {self.problem}"

    @property
    def typed(self) -> bool:
        """Whether it names an option or an argument, not a key."""
        return self.path.startswith("--") or self.path.isupper()


class ConfigError(AbsError):
    """Wrong configuration or usage; `mistakes` has all of them."""

    exit_code = 2

    def __init__(self, mistakes: Sequence[ConfigIssue]) -> None:
        self.mistakes = tuple(mistakes)
        lines = [f"  {mistake}" for mistake in self.mistakes]
        count = f"{len(lines)} mistakes" if len(lines) > 1 else "a mistake"
        super().__init__("\n".join([f"the {self._place()} has {count}; nothing was started:", *_on_a_screen(lines)]))

    def _place(self) -> str:
        return "command line" if all(mistake.typed for mistake in self.mistakes) else "configuration"

    @classmethod
    def of(cls, path: str, problem: str) -> Self:
        """Return the error with one issue."""
        return cls([ConfigIssue(path, problem)])

    def __reduce__(self) -> tuple[type[ConfigError], tuple[tuple[ConfigIssue, ...]]]:
        """Rebuild an error of another process from its mistakes, not from its text."""
        return type(self), (self.mistakes,)


class ArgumentError(ConfigError):
    """Wrong arguments of a function of the Python interface; each of the `mistakes` names its parameter."""

    def _place(self) -> str:
        return "call"


class BoardError(AbsError):
    """The board is missing, unknown, refuses, or cannot be made safe."""


class LinkError(BoardError):
    """One exchange with the board failed."""


class NoAnswerError(LinkError):
    """The board did not answer in time; its answer may still come."""


class UnsafeError(BoardError):
    """SAFE could not be confirmed: motor power may still be on."""

    exit_code = 5


class ReadOnlyError(BoardError):
    """The board is open for reading only, and something asked for an output."""


class ControllerError(AbsError):
    """A user's controller failed in its process; the text is that of its error."""


class SessionError(AbsError):
    """A session file cannot be written, read or replayed."""


class CaptureError(AbsError):
    """A capture of the wire cannot be written, imported, read or replayed."""


class CommissioningError(AbsError):
    """A step of the commissioning failed; the draft stays as it was before the step."""


class AnswerError(CommissioningError):
    """The operator's answer was not one of those asked for: nothing is wrong with board or profile."""


class Stopped(CommissioningError):  # noqa: N818  leaving is nothing wrong
    """The operator left the commissioning, which can continue later."""

    exit_code = 130


def _on_a_screen(lines: Sequence[str]) -> list[str]:
    """Return the lines that fit on a screen, and the number of the others."""
    shown, height = list[str](), 0
    for line in lines:
        height += -(-len(line) // _SCREEN_COLUMNS)
        if shown and height > _SCREEN_LINES:
            return [*shown, f"  and {len(lines) - len(shown)} more, once these are fixed"]
        shown.append(line)
    return shown


def refusals(conditions: Iterable[Callable[[], object]]) -> list[AbsError]:
    """Return the errors that `conditions` raise; empty if all hold."""
    found = []
    for condition in conditions:
        try:
            condition()
        except AbsError as error:
            found.append(error)
    return found


def near_match(word: str, known: Iterable[str]) -> str:
    """Return the end of a message about a wrong name: `"; did you mean X?"`, or the known names if none is similar."""
    known = sorted(known)
    near = difflib.get_close_matches(word, known, n=1, cutoff=_ALIKE)
    return f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known) or 'none'}"


def describe_disk(error: OSError) -> str:
    """Describe why a file or folder cannot be written, and what to do."""
    why = error.strerror or str(error)
    return f"{why}; {_TO_DO[error.errno]}" if error.errno in _TO_DO else why


def shortened(value: object) -> str:
    """A value as in a TOML file, on one line of at most 63 characters."""
    try:
        text = str(value).lower() if isinstance(value, bool) else repr(value)
    except ValueError:  # Python prints no integer of more than 4300 digits
        return "a number of absurdly many digits"
    text = value.isoformat() if isinstance(value, date | time) else text
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def near_file(path: Path) -> str:
    """Return the end of a message about a missing file: `"; did you mean X?"` or `"; there is no folder X"`, or ""."""
    try:
        names = [other.name for other in path.parent.iterdir() if other.exists()]  # not a link to nowhere
    except FileNotFoundError:
        return f"; there is no folder {path.parent}"
    except OSError:
        return ""
    # all names of one folder have like suffixes: the rest must be alike, too
    alike = [name for name in names if difflib.get_close_matches(path.stem, [Path(name).stem], cutoff=_ALIKE_FILES)]
    near = difflib.get_close_matches(path.name, alike, n=1)
    return f"; did you mean {path.with_name(near[0])}?" if near else ""


def on_one_line(error: AbsError) -> str:
    """Return an error's text on one line."""
    if isinstance(error, ConfigError):
        return "; ".join(mistake.problem for mistake in error.mistakes)
    return str(error)


def place_in(error: BaseException, file: str) -> str:
    """Return `", line N"` of `file` where `error` was raised, or an empty text."""
    if isinstance(error, SyntaxError) and error.filename == file:
        return f", line {error.lineno}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f", line {lines[-1]}" if lines else ""


def line_of(file: str, line: int | None) -> str:
    """A line of a file, as in messages."""
    return f"{Path(file).name}, line {line}"


def describe_error(error: BaseException) -> str:
    """Describe an error by type, text and place: where its last note says, or where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    raised = [line_of(frames[-1].filename, frames[-1].lineno)] if frames else []
    noted = [note for note in getattr(error, "__notes__", ()) if _PLACE.fullmatch(note)]
    place = "".join(f" ({each})" for each in (noted or raised)[-1:])
    text = str(error)
    return f"{type(error).__name__}: {text if len(text) <= _LONGEST else text[:_LONGEST] + '...'}{place}"
