"""The verb `inteco-abs golden`: add, test, update, list."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.options import DIFFERS, FILE, Finite, VerbGroup, json_option, known_controllers
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import print_json, say, show

if TYPE_CHECKING:
    from inteco_abs.analysis import Golden, GoldenFolder, GoldenResult


def _folder_option(function: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--folder",
        type=FILE,
        default="golden",
        show_default=True,
        help="Folder of the golden sessions and their table.",
    )(function)


def _controller_option(function: Callable[..., Any]) -> Callable[..., Any]:
    help_text = "Your own controller, named as in the run: file.py:Class."
    return click.option("--controller", metavar="FILE:CLASS", help=help_text)(function)


def _reason_option(function: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--reason", required=True, help="Reason, kept in the history.")(function)


@click.group(cls=VerbGroup)
def golden() -> None:
    """Keep recorded runs as regression tests.

    The current code replays a golden session and must repeat each of its decisions.
    """


@golden.command()
@click.argument("file", type=FILE)
@click.option("--name", help="Name of the golden session; default: the file's name.")
@click.option(
    "--tol",
    "tolerances",
    multiple=True,
    metavar="FIELD=ABS[:REL[:LEAD_S[:LAG_S]]]",
    help="Tolerance as for replay; default: bit for bit.",
)
@click.option(
    "--until", "until_s", type=Finite(unit="s"), metavar="SECONDS", help="Cut the copy this long after braking."
)
@_controller_option
@_reason_option
@_folder_option
@json_option
def add(
    file: Path,
    name: str | None,
    tolerances: tuple[str, ...],
    until_s: float | None,
    controller: str | None,
    reason: str,
    folder: Path,
    as_json: bool,
) -> int:
    """Add a copy of a session, without the simulation's truth.

    It overwrites nothing, and refuses a session that was cut, that hardly brakes, or that does not replay now.
    Exit codes: 0 done, 1 the session is refused, 2 wrong usage.
    """
    from inteco_abs.analysis import GoldenFolder
    from inteco_abs.sessions import read_session

    goldens = GoldenFolder(folder)
    session = read_whole(file, read_session)
    known = known_controllers(controller)
    kept = goldens.add(session, name or file.stem, reason, known, tolerances, until_s)
    _report(goldens, kept, as_json=as_json)
    return 0


@golden.command()
@click.argument("names", nargs=-1)
@_controller_option
@_folder_option
@json_option
def test(names: tuple[str, ...], controller: str | None, folder: Path, as_json: bool) -> int:
    """Replay golden sessions and report differences.

    Exit codes: 0 all decisions agree, 4 some differ, 1 a session cannot be used, 2 wrong usage.
    """
    from dataclasses import asdict

    from inteco_abs.analysis import GoldenFolder

    verdicts = GoldenFolder(folder).test(names, known_controllers(controller))
    differing = [verdict.name for verdict in verdicts if verdict.replay and verdict.replay.differing]
    if as_json:
        print_json({"schema_version": 1, "differing": differing, "sessions": [asdict(verdict) for verdict in verdicts]})
    else:
        for verdict in verdicts:
            say(_line(verdict))
    return DIFFERS if differing else 1 if any(verdict.problem for verdict in verdicts) else 0


@golden.command()
@click.argument("name")
@_controller_option
@_reason_option
@_folder_option
@json_option
def update(name: str, controller: str | None, reason: str, folder: Path, as_json: bool) -> int:
    """Accept the current decisions of a golden session.

    Its inputs stay, and the history keeps the reason.

    Exit codes: 0 done, 1 the session cannot be used, 2 wrong usage, or nothing would change.
    """
    from inteco_abs.analysis import GoldenFolder

    goldens = GoldenFolder(folder)
    _report(goldens, goldens.update(name, reason, known_controllers(controller)), as_json=as_json)
    return 0


@golden.command("list")
@_folder_option
@json_option
def list_all(folder: Path, as_json: bool) -> int:
    """List the golden sessions.

    Exit codes: 0 done, 1 the table cannot be used, 2 wrong usage, or there are none.
    """
    from dataclasses import asdict

    from inteco_abs.analysis import GoldenFolder

    goldens = GoldenFolder(folder).chosen(())
    if as_json:
        print_json({"schema_version": 1, "sessions": [asdict(each) for each in goldens]})
    else:
        from rich.table import Table

        table = Table("name", "ticks", "tolerances", "version", "reason", box=None, header_style="dim")
        for each in goldens:
            newest = each.history[-1]
            version = f"{len(each.history)}, {newest.date[:10]}"
            table.add_row(each.name, str(each.ticks), " ".join(each.tolerances) or "exact", version, newest.reason)
        show(table)
    return 0


def _report(goldens: GoldenFolder, kept: Golden, *, as_json: bool) -> None:
    from dataclasses import asdict

    file = goldens.file(kept)
    if as_json:
        print_json({"schema_version": 1, "file": str(file), **asdict(kept)})
        return
    newest = kept.history[-1]
    changed = f", {newest.changed_ticks} of them changed" if newest.changed_ticks else ""
    say(f"{file}: {kept.ticks} ticks{changed}, {file.stat().st_size / 1000:.0f} kB; {newest.reason}")


def _line(verdict: GoldenResult) -> str:
    from inteco_abs.sessions import describe_other_arithmetic

    if verdict.replay is None:
        return f"{verdict.name}: cannot be tested: {verdict.problem}"
    first = verdict.replay.first
    if first is None:
        return f"{verdict.name}: {verdict.replay.ticks} ticks replayed, none differ"
    count = f"{verdict.replay.differing} of {verdict.replay.ticks} ticks differ"
    was, now = f"{first.logged} ({first.logged_hex})", f"{first.replayed} ({first.replayed_hex})"
    other = verdict.replay.arithmetic
    why = f"; {describe_other_arithmetic(other)}" if other else ""
    return f"{verdict.name}: {count}, first at tick {first.tick}: {first.field} was {was}, is {now}{why}"
