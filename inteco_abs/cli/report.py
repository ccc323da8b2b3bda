"""The verb `report`: a session, or several beside one another, as a page for the browser."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import FILE, LOSSES, read_whole, say


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@click.option(
    "--out", "-o", type=FILE, help="Page to write, .html; default: FILE with .html, of several comparison.html."
)
def report(files: tuple[Path, ...], out: Path | None) -> int:
    """Make one HTML page of a session, or of several to compare: card, plots, gains, warnings, commands.

    The page holds everything that it needs and loads nothing: it can be kept beside the session, mailed and printed.
    Needs the extra `report`, and `figures` for the figure that is printed in place of the plots.
    """
    from inteco_abs.sessions import read_session
    from inteco_abs.views.report import check_report, write_report

    page = out or (files[0].with_suffix(".html") if len(files) == 1 else Path("comparison.html"))
    check_report(page)
    sessions = [read_whole(file, read_session) for file in files]
    write_report(sessions, page)
    say(f"report: {page}", err=True)
    return LOSSES if any(session.incomplete or session.beyond for session in sessions) else 0
