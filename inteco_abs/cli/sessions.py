"""Verbs that show a session: info, figure."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.options import FILE, LOSSES, draw, json_option, plain, print_json, read_whole, say

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from rich.table import Table

    from inteco_abs.sessions import Session


@click.command()
@click.argument("file", type=FILE)
@click.option("--all", "everything", is_flag=True, help="Also print every record that the session holds.")
@json_option
def info(file: Path, everything: bool, as_json: bool) -> int:
    """What a session holds, how it ended, and with what it was run; --json has all of it."""
    from inteco_abs.sessions import read_session

    session = read_whole(file, read_session)
    summary = _summary(session)
    if as_json:
        print_json(summary)
    else:
        _print_summary(session, summary, everything=everything)
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


def _print_summary(session: Session, summary: Mapping[str, Any], *, everything: bool) -> None:
    """What one asks first, on one screen."""
    from rich.console import Console

    console = Console(markup=False, highlight=False)
    console.print(_table(_first_facts(summary)))
    console.print(_results(session))
    if everything:
        console.print(_table(_records(summary)))
    else:
        count = sum(map(len, summary["metadata"].values()))
        say(f"--all prints the {count} facts that the session holds, --json too; inteco-abs get takes files out")


def _first_facts(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    metadata = summary["metadata"]

    def told(record: str, *keys: str) -> str:
        facts = metadata.get(record, {})
        return " ".join(facts[key] for key in keys if facts.get(key))

    def is_true(record: str, key: str) -> bool:
        return told(record, key) == "true"

    law = metadata.get("controller", {})
    names = [key for key in law if key.startswith("gain.") and not key.endswith(".hex")]
    gains = [f"{key.partition('.')[2]}={law[key]}" for key in names]
    commit = f"{told('software', 'git_commit')[:10]}{' with changes' if is_true('software', 'git_dirty') else ''}"
    place = f"{'simulated' if is_true('rig', 'simulated') else 'real'} rig {told('rig', 'drawn')}".strip()
    time = "virtual time" if is_true("rig", "virtual_time") else "real time"
    lasted = f"{summary['duration_s']:.3f} s, {summary['ticks']} ticks, {summary['events']} events"
    yield "session", summary["session"]
    yield "outcome", told("session", "outcome") or "-"
    yield "reason", told("session", "reason") or "-"
    yield "recorded", f"{told('session', 'started_utc') or '-'}, {lasted}"
    yield "controller", f"{told('controller', 'name') or '-'} on {told('controller', 'estimator') or '-'}"
    yield "gains", ", ".join([f"reference_slip={told('controller', 'reference_slip') or '-'}", *gains])
    yield "board", f"{told('rig', 'board', 'logic_version', 'application_name')}, profile {told('rig', 'profile')}"
    yield "rig", f"{place}, {time}"
    if faults := metadata.get("injected"):
        yield "injected", ", ".join(f"{fault} acted {times} times" for fault, times in faults.items())
    yield "software", f"inteco-abs {told('software', 'version')} {commit}, Python {told('software', 'python')}"
    yield "host", told("host", "hostname", "os", "kernel") or "-"
    yield "files", ", ".join(summary["attachments"]) or "none"


def _records(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key in ("events", "frames"):
        yield key, str(summary[key])
    for name, facts in summary["metadata"].items():
        for key, value in facts.items():
            yield f"{name}.{key}", str(value)
    for name, size in summary["attachments"].items():
        yield f"attachment {name}", f"{size} bytes"


def _results(session: Session) -> Table:
    """The result card, two results a line; what was not measured is left out."""
    from rich.table import Table

    from inteco_abs.views.report.facts import NOTHING, result_rows

    cells = [(row.name, plain(row.values[0])) for row in result_rows([session]) if row.values[0] != NOTHING]
    table = Table.grid(padding=(0, 2))
    for _ in range(2):
        table.add_column(style="dim", no_wrap=True)
        table.add_column(justify="right", no_wrap=True)
    half = -(-len(cells) // 2)
    for number, cell in enumerate(cells[:half]):
        table.add_row(*cell, *(cells[half + number] if half + number < len(cells) else ("", "")))
    return table


def _table(rows: Iterable[tuple[str, str]]) -> Table:
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(plain(name), plain(value))
    return table
