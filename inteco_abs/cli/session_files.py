"""Session files of the verbs: read with a report of losses, drawn, checked before a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from inteco_abs.cli.terminal import plain, say

if TYPE_CHECKING:
    from inteco_abs.sessions import Session
    from inteco_abs.views.figure_options import FigureOptions


def read_whole(file: Path, reader: Callable[[Path], Session]) -> Session:
    """The session in `file`; reports on stderr what it lacks."""
    session = reader(file)
    report_losses(session)
    return session


def report_losses(session: Session) -> None:
    """Report what a session lacks, and what to do about it."""
    if session.incomplete:
        ticks = session.tick_count
        whole = f"{ticks} ticks are complete{'; recover makes a session of them' if ticks else ''}"
        say(f"inteco-abs: {session.path}: {session.incomplete}; {whole}", err=True)
    if session.unsupported:
        say(f"inteco-abs: {session.path}: {plain(session.unsupported)}", err=True)


def draw(files: Sequence[Path], out: Path, options: FigureOptions | None = None) -> bool:
    """Draw stops to `out`; return whether every file was complete and fully understood."""
    from inteco_abs.sessions import read_session
    from inteco_abs.views.figure import draw_stops

    sessions = [read_whole(file, read_session) for file in files]
    draw_stops(sessions, out, *([options] if options else []))
    say(f"figure: {out}", err=True)
    return not any(session.incomplete or session.unsupported for session in sessions)
