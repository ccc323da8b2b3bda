"""What all answers to wrong input have in common: a row has the command, and the words of its answer.

An answer fits on one screen, ends with the exit code that the command documents, prints nothing to stdout but data,
leaves nothing behind, moves nothing, and says what to do.
"""

import resource
import shlex
import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from inteco_abs.mock_board import Device

COLUMNS, LINES = 80, 24


class Row(NamedTuple):
    """One wrong input."""

    name: str
    command: str
    """As it is typed after `inteco-abs`."""
    code: int
    words: tuple[str, ...]
    """What is wrong: the thing, the value seen, what is allowed."""
    fix: str
    """What to do, in the message's words."""
    given: tuple[Callable, ...] = ()
    """What makes the folder, or the computer, so; each is called with a Place."""
    leaves: tuple[str, ...] = ()
    """What is rightly left behind."""
    runs: bool = False
    """Whether the rig has moved before anything was wrong, so that there is a result."""


class Place(NamedTuple):
    """The folder in which a row is typed."""

    folder: Path
    patch: object
    """Pytest's monkeypatch."""
    stop: Callable[[], bytes]
    """A session of a whole stop."""
    opened: Callable
    """Opens a file to be read until the end."""


def file(name, content=""):
    """A file with that text, or those bytes."""
    return lambda place: (place.folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())


def folder(name):
    return lambda place: (place.folder / name).mkdir()


def session(name="stop.mcap", change=lambda data: data):
    """A session, of which `change` has made something else."""
    return lambda place: (place.folder / name).write_bytes(change(place.stop()))


def without(*modules):
    """A computer on which these are not installed."""

    def take_away(place):
        for module in modules:
            place.patch.setitem(sys.modules, module, None)

    return take_away


def stdin(stream):
    """Standard input without typing; None if the shell has closed it."""

    def take(place):
        place.patch.setattr(sys, "stdin", stream and place.opened(stream))

    return take


@contextmanager
def full_disk():
    """No file may grow: what a disk without room answers is the same but for the word."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def ids(rows):
    return [row.name.replace(" ", "-") for row in rows]


class Answers:
    """Runs a row's command in its folder, and requires what holds for every answer."""

    def __init__(self, main_here, place) -> None:
        self._main_here, self.place, self._devices = main_here, place, []
        made = Device.__init__

        def noted(device, *arguments, **named):
            made(device, *arguments, **named)
            self._devices.append(device)

        place.patch.setattr(Device, "__init__", noted)

    def to(self, row):
        for prepare in row.given:
            prepare(self.place)
        before = self._files()
        self._devices.clear()
        answer = self._main_here(*shlex.split(row.command))
        assert answer.returncode == row.code, answer.stderr
        said = " ".join(answer.stderr.split())
        for word in (*row.words, row.fix):
            assert word in said, f"{word!r} is not in: {answer.stderr}"
        height = sum(-(-len(line) // COLUMNS) or 1 for line in answer.stderr.splitlines())
        assert height <= LINES, f"{height} lines: {answer.stderr}"
        if not row.runs:
            assert answer.stdout == ""
        after = self._files()
        assert {name: after.get(name) for name in before} == before
        assert after.keys() - before.keys() == {Path(name) for name in row.leaves}
        assert all(device.duties == (0.0, 0.0) for device in self._devices)
        assert row.runs or not any(device.truth().road_speed_rad_s for device in self._devices)
        return answer

    def _files(self):
        """What the folder holds: content by path, of folders None."""
        folder = self.place.folder
        found = folder.rglob("*")
        return {path.relative_to(folder): path.read_bytes() if path.is_file() else None for path in found}
