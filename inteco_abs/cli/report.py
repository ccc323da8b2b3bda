"""The verb `inteco-abs report`."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import FILE, LOSSES
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import say


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@click.option(
    "--out", "-o", type=FILE, help="Page to write (.html); default: FILE with .html, or comparison.html for several."
)
def report(files: tuple[Path, ...], out: Path | None) -> int:
    """Write one HTML page about one or more sessions.

    It shows card, plots, gains, warnings and commands. The page loads nothing else: you can keep it beside the
    session, mail it and print it. Needs the extra `report`, and `figures` for the figure that replaces the plots in
    print.
    """
    from inteco_abs.sessions import read_session
    from inteco_abs.views.report import check_report, report_path, write_report

    page = out or report_path(files)
    check_report(page)
    sessions = [read_whole(file, read_session) for file in files]
    write_report(sessions, page)
    say(f"report: {page}", err=True)
    return LOSSES if any(session.incomplete or session.unsupported for session in sessions) else 0
