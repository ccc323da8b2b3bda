"""Display of a running stop: dashboard, one line, or none."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from inteco_abs.cli.terminal import on_terminal, say
from inteco_abs.errors import ConfigError

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.realtime import Screen, Tuner
    from inteco_abs.views.dashboard import Dashboard


@contextmanager
def screen_of(
    config: RigConfig, choice: str | None, *, virtual: bool, quiet: bool, tuner: Tuner | None = None
) -> Iterator[Screen]:
    """Dashboard on a terminal's stderr; elsewhere, or if not wanted, one line when a run in real time begins."""
    if quiet or not dashboard_wanted(choice):
        from inteco_abs.realtime import Lines

        stops = partial(say, "running in real time; Ctrl-C stops safely", err=True)
        begun = (lambda: None) if quiet or virtual else stops
        yield Lines(lambda text: say(f"inteco-abs: {text}", err=True), noting=not quiet, begun=begun)
        return
    with dashboard_of(config, choice, virtual=virtual, tuner=tuner) as dashboard:
        yield dashboard


def dashboard_wanted(choice: str | None) -> bool:
    """Whether there is a terminal for a dashboard, unless the user wants none."""
    return choice != "none" and on_terminal(sys.stderr) and os.environ.get("TERM") != "dumb"


def require_keyboard(choice: str | None, *, virtual: bool, quiet: bool) -> None:
    """Raise ConfigError unless a person can change gains with keys while the run lasts."""
    if virtual:
        problem = "virtual time is over before you can change a gain; omit one of the two, or plan it with --change"
    elif quiet or choice in {"line", "none"} or not (dashboard_wanted(choice) and on_terminal(sys.stdin)):
        problem = "needs the whole display on a terminal, for its keys; elsewhere plan the change with --change"
    else:
        return
    raise ConfigError.of("--tune", problem)


def dashboard_of(
    config: RigConfig,
    choice: str | None,
    *,
    virtual: bool = False,
    playback: bool = False,
    tuner: Tuner | None = None,
) -> Dashboard:
    """The dashboard on stderr."""
    from rich.console import Console

    from inteco_abs.views.dashboard import Dashboard

    line = choice == "line" or (choice is None and not on_terminal(sys.stdout))
    console, plain = Console(stderr=True, highlight=False), ascii_wanted()
    return Dashboard(console, config, virtual=virtual, line=line, plain=plain, playback=playback, tuner=tuner)


def ascii_wanted() -> bool:
    """Whether the user's locale has ASCII only; Python would still write UTF-8."""
    # LC_CTYPE=C.UTF-8 is Python's own answer to that locale, if nothing else was set
    chosen = (os.environ.get("LC_ALL"), os.environ.get("LC_CTYPE", "").replace("C.UTF-8", ""), os.environ.get("LANG"))
    return next(filter(None, chosen), "") in {"C", "POSIX"}
