"""Verbs that show a session: info, figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.shared import FILE, LOSSES, draw, json_option, plain, print_json, read_whole

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inteco_abs.sessions import Session


@click.command()
@click.argument("file", type=FILE)
@json_option
def info(file: Path, as_json: bool) -> int:
    """What a session holds, how it ended, and with what it was run."""
    from inteco_abs.sessions import read_session

    session = read_whole(file, read_session)
    summary = _summary(session)
    if as_json:
        print_json(summary)
    else:
        _print_summary(summary)
    return LOSSES if session.incomplete or session.beyond else 0


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@click.option("--out", "-o", type=FILE, required=True, help="Figure to write: .png, .svg or .pdf.")
@click.option(
    "--width",
    type=click.Choice(("one", "two")),
    default="two",
    show_default=True,
    help="Columns of a journal's page: one is 88 mm, two are 180 mm.",
)
def figure(files: tuple[Path, ...], out: Path, width: str) -> int:
    """Draw stops for a paper: speeds, slip, brake torque.

    Several sessions lie over one another, and a legend names what differs. The same sessions give the same file.
    """
    from inteco_abs.views.figure import check_figure

    check_figure(out, "--out")
    return 0 if draw(files, out, width) else LOSSES


def _summary(session: Session) -> dict[str, Any]:
    from inteco_abs.sessions import stored_card

    ticks = session.ticks
    seconds = (int(ticks["time_ns"][-1]) - int(ticks["time_ns"][0])) * 1e-9 if len(ticks) else 0.0
    return {
        "schema_version": 1,
        "session": str(session.path),
        "incomplete": session.incomplete,
        "beyond": session.beyond,
        "ticks": len(ticks),
        "duration_s": seconds,
        "events": session.events,
        "frames": session.frames,
        "attachments": {name: len(data) for name, data in session.attachments.items()},
        "metadata": {name: facts for name, facts in session.metadata.items() if name != "result"},
        "result": stored_card(session.metadata),
    }


def _print_summary(summary: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    metadata = summary["metadata"]
    table.add_row("session", plain(summary["session"]))
    for key in ("outcome", "reason"):  # first, as a screen holds less than all
        table.add_row(key, plain(metadata.get("session", {}).get(key) or "-"))
    for key in ("ticks", "duration_s", "events", "frames"):
        table.add_row(key, plain(summary[key]))
    for name, facts in metadata.items():
        for key, value in facts.items():
            table.add_row(plain(f"{name}.{key}"), plain(value))
    for name, size in summary["attachments"].items():
        table.add_row(plain(f"attachment {name}"), f"{size} bytes")
    Console(markup=False).print(table)
