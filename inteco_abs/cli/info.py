"""The verb `inteco-abs info`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.options import LOSSES, SESSION, json_option
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import plain, print_json, say, show

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from rich.table import Table

    from inteco_abs.sessions import Session


@click.command()
@click.argument("file", type=SESSION)
@click.option("--all", "everything", is_flag=True, help="Also print every record of the session.")
@json_option
def info(file: Path, everything: bool, as_json: bool) -> int:
    """Show what a session holds and how it ended.

    --json prints all of it.
    """
    from inteco_abs.sessions import open_session

    session = read_whole(file, open_session)
    summary = _summary(session)
    if as_json:
        print_json(summary)
    else:
        _print_summary(session, summary, everything=everything)
    return LOSSES if session.incomplete or session.unsupported else 0


def _summary(session: Session) -> dict[str, Any]:
    from inteco_abs.analysis import listed_changes
    from inteco_abs.sessions import gains_of, stored_card

    return {
        "schema_version": 1,
        "session": str(session.path),
        "incomplete": session.incomplete,
        "beyond": session.unsupported,
        "ticks": session.tick_count,
        "duration_s": session.duration_s,
        "events": session.events,
        "frames": session.frames,
        "attachments": {name: len(data) for name, data in session.attachments.items()},
        "gains": {each.name: {"unit": each.unit, "meaning": each.meaning} for each in gains_of(session.channels)},
        "changes": listed_changes(session),
        "metadata": {name: facts for name, facts in session.metadata.items() if name != "result"},
        "result": stored_card(session.metadata),
    }


def _print_summary(session: Session, summary: Mapping[str, Any], *, everything: bool) -> None:
    """The main facts, on one screen."""
    show(_table(_first_facts(summary)), _results(session))
    if everything:
        show(_table(_records(summary)))
    else:
        count = sum(map(len, summary["metadata"].values()))
        say(f"--all or --json prints all {count} facts; inteco-abs extract writes out the files")


def _first_facts(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    metadata = summary["metadata"]

    def joined(record: str, *keys: str) -> str:
        facts = metadata.get(record, {})
        return " ".join(facts[key] for key in keys if facts.get(key))

    def is_true(record: str, key: str) -> bool:
        return joined(record, key) == "true"

    law = metadata.get("controller", {})
    names = [key for key in law if key.startswith("gain.") and not key.endswith(".hex")]
    units = {name: each["unit"] for name, each in summary["gains"].items() if each["unit"] not in {"", "1"}}
    gains = [f"{name}={law[key]}{f' {units[name]}' if name in units else ''}" for key in names for name in [key[5:]]]
    commit = f"{joined('software', 'git_commit')[:10]}{' with changes' if is_true('software', 'git_dirty') else ''}"
    place = f"{'simulated' if is_true('rig', 'simulated') else 'real'} rig {joined('rig', 'drawn')}".strip()
    time = "virtual time" if is_true("rig", "virtual_time") else "real time"
    lasted = f"{summary['duration_s']:.3f} s, {summary['ticks']} ticks, {summary['events']} events"
    yield "session", summary["session"]
    yield "outcome", joined("session", "outcome") or "-"
    yield "reason", joined("session", "reason") or "-"
    if died := joined("session", "died"):
        yield "died", f"{died}; the last tick is {joined('session', 'last_tick') or 'unknown'}"
    yield "recorded", f"{joined('session', 'started_utc') or '-'}, {lasted}"
    yield "controller", f"{joined('controller', 'name') or '-'} on {joined('controller', 'estimator') or '-'}"
    reference = joined("controller", "reference") or joined("controller", "reference_slip") or "-"
    yield "gains", ", ".join([f"reference_slip={reference}", *gains])
    if summary["changes"]:
        yield (
            "changes",
            ", ".join(f"{name}: {value}" for name, value in summary["changes"].items()),
        )
    yield "board", f"{joined('rig', 'board', 'logic_version', 'application_name')}, profile {joined('rig', 'profile')}"
    yield "rig", f"{place}, {time}"
    if roads := joined("rig", "roads"):
        yield "roads", roads
    if faults := metadata.get("injected"):
        yield "injected", ", ".join(f"{fault} acted {times} times" for fault, times in faults.items())
    described = metadata.get("description", {})
    for key in ("purpose", "note", "tags", "licence"):
        if described.get(key):
            yield key, described[key]
    if who := joined("description", "operator", "orcid", "institution"):
        yield "operator", who
    yield "software", f"inteco-abs {joined('software', 'version')} {commit}, Python {joined('software', 'python')}"
    yield "host", joined("host", "hostname", "os", "kernel") or "-"
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
    """The result card, two results a line, without those that were not measured."""
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
