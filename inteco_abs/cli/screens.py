"""The display of a run while it lasts: a full screen, one line, or none."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from inteco_abs.cli.terminal import on_terminal, say

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.realtime import Screen


@contextmanager
def screen_of(config: RigConfig, choice: str | None, *, virtual: bool, quiet: bool) -> Iterator[Screen]:
    """Live picture on a terminal's stderr; elsewhere, or if not wanted, a line where a run in real time begins."""
    if quiet or choice == "none" or not on_terminal(sys.stderr) or os.environ.get("TERM") == "dumb":
        from inteco_abs.realtime import Lines

        begun = (lambda: None) if quiet or virtual else _say_what_stops
        yield Lines(_say, noting=not quiet, begun=begun)
        return
    from rich.console import Console

    from inteco_abs.views.dashboard import Dashboard

    line = choice == "line" or (choice is None and not on_terminal(sys.stdout))
    console, plain = Console(stderr=True, highlight=False), ascii_wanted()
    with Dashboard(console, config, virtual=virtual, line=line, plain=plain) as dashboard:
        yield dashboard


def ascii_wanted() -> bool:
    """Whether the user's locale is the one that has ASCII only; Python would write UTF-8 all the same."""
    # LC_CTYPE=C.UTF-8 is Python's own answer to that locale, if nothing else was set
    chosen = (os.environ.get("LC_ALL"), os.environ.get("LC_CTYPE", "").replace("C.UTF-8", ""), os.environ.get("LANG"))
    return next(filter(None, chosen), "") in {"C", "POSIX"}


def _say_what_stops() -> None:
    say("running in real time; Ctrl-C stops safely", err=True)


def _say(text: str) -> None:
    say(f"inteco-abs: {text}", err=True)
