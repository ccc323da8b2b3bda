"""Who shows a run while it lasts: the whole picture, a line, or nobody."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.options import on_terminal, say

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.realtime.screen import Screen


def live_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """`--live` and `--quiet`."""
    quiet = click.option("--quiet", "-q", is_flag=True, help="Say nothing but errors and warnings.")
    live = click.option(
        "--live",
        type=click.Choice(("full", "line", "none")),
        help="How to show the run while it lasts; default: what the terminal has room for.",
    )
    return live(quiet(function))


@contextmanager
def screen_of(config: RigConfig, choice: str | None, *, virtual: bool, quiet: bool) -> Iterator[Screen]:
    """Live picture on a terminal's stderr; elsewhere, or if nobody wants it, a line where a run in real time begins."""
    if quiet or choice == "none" or not on_terminal(sys.stderr) or os.environ.get("TERM") == "dumb":
        from inteco_abs.realtime.screen import Lines

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
