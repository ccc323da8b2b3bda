"""Verbs for what a run has left: replay, info, recover, figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.shared import (
    DIFFERS,
    FILE,
    LOSSES,
    draw,
    json_option,
    known_controllers,
    print_card,
    print_json,
    read_whole,
)
from inteco_abs.errors import ConfigError, Mistake, near_match

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inteco_abs.plugins import Controllers, Origin
    from inteco_abs.sessions import Replay, Session


@click.command()
@click.argument("file", type=FILE)
@click.option("--controller", help="Your own controller as file.py:Class, if the session was run with one.")
@json_option
def replay(file: Path, controller: str | None, as_json: bool) -> int:
    """Run the decisions of a session again and compare them bit for bit."""
    from dataclasses import asdict

    from inteco_abs.control import build_pipeline, control_check
    from inteco_abs.sessions import read_session, session_config
    from inteco_abs.sessions import replay as run_again

    session = read_whole(file, read_session)
    controllers = _controllers_for(session, controller)
    config = session_config(session, (control_check(controllers),))
    outcome = run_again(session, build_pipeline(config, controllers))
    report = {"schema_version": 1, "session": str(file), "incomplete": session.incomplete, **asdict(outcome)}
    if as_json:
        print_json(report)
    else:
        _print_replay(file, outcome)
    return DIFFERS if outcome.differing else LOSSES if session.incomplete else 0


def _controllers_for(session: Session, controller: str | None) -> Controllers:
    """Controllers with the session's among them, or `controller` in its place. Raises ConfigError if there is none."""
    from inteco_abs.plugins import FROM_FILE, Controllers

    controllers = known_controllers(controller)
    told = session.metadata.get("controller", {})
    name, package = told.get("name", ""), told.get("package", "")
    if controller is not None:
        if controller not in controllers:
            raise ConfigError(
                [Mistake("--controller", f"no controller {controller!r}{near_match(controller, controllers)}")]
            )
        controllers = Controllers({name: (controllers[controller], controllers.origin(controller))})
    elif FROM_FILE in name:
        raise ConfigError([Mistake("--controller", f"the session was run with {name!r}; name that file to replay it")])
    elif package and name not in controllers:
        problem = f"the session was run with {name!r} of the package {package}, which is not installed; install it"
        raise ConfigError([Mistake("--controller", problem)])
    if name in controllers:
        _tell_of_another(controllers.origin(name), session.attachments.get("controller.py"), package)
    return controllers


def _tell_of_another(origin: Origin, source: bytes | None, package: str) -> None:
    """Say so if the controller is not what the session was run with."""
    if package not in {"", origin.package}:
        click.echo(
            f"inteco-abs: the session was run with {package}, and this is {origin.package or 'another'}", err=True
        )
    if source not in {None, origin.source}:
        click.echo("inteco-abs: the controller's source is not the one that the session was run with", err=True)


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
    return LOSSES if session.incomplete else 0


@click.command()
@click.argument("ring", type=FILE)
@click.option("--out", "-o", type=FILE, required=True, help="Session file to write.")
@json_option
def recover(ring: Path, out: Path, as_json: bool) -> int:
    """Write the session of a run whose processes all crashed, from the memory that it left in RING."""
    from inteco_abs.realtime.recorder import recover_run

    account = recover_run(ring, out)
    if as_json:
        print_json(account.card)
    else:
        print_card(account.card, account.explanation)
    return LOSSES if account.card["lost_ticks"] else 0


@click.command()
@click.argument("file", type=FILE)
@click.option("--out", "-o", type=FILE, required=True, help="Figure to write: .png, .svg or .pdf.")
def figure(file: Path, out: Path) -> int:
    """Draw a session: speeds, slip, brake."""
    draw(file, out)
    return 0


def _summary(session: Session) -> dict[str, Any]:
    ticks = session.ticks
    seconds = (int(ticks["time_ns"][-1]) - int(ticks["time_ns"][0])) * 1e-9 if len(ticks) else 0.0
    result = session.metadata.get("result", {}).get("card")
    return {
        "schema_version": 1,
        "session": str(session.path),
        "incomplete": session.incomplete,
        "ticks": len(ticks),
        "duration_s": seconds,
        "events": session.events,
        "attachments": {name: len(data) for name, data in session.attachments.items()},
        "metadata": {name: facts for name, facts in session.metadata.items() if name != "result"},
        "result": json.loads(result) if result else None,
    }


def _print_replay(file: Path, outcome: Replay) -> None:
    if outcome.first is None:
        click.echo(f"{file}: {outcome.ticks} ticks ({outcome.braking_ticks} braking) replayed, none differs")
        return
    first = outcome.first
    click.echo(
        f"{file}: {outcome.differing} of {outcome.ticks} ticks differ, first at tick {first.tick}: {first.field}"
    )
    click.echo(f"  logged   {first.logged}  {first.logged_hex}")
    click.echo(f"  replayed {first.replayed}  {first.replayed_hex}")
    for name, count in outcome.by_field.items():
        click.echo(f"  {name}: {count} ticks")


def _print_summary(summary: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for key in ("session", "ticks", "duration_s", "events"):
        table.add_row(key, str(summary[key]))
    for name, facts in summary["metadata"].items():
        for key, value in facts.items():
            table.add_row(f"{name}.{key}", value)
    for name, size in summary["attachments"].items():
        table.add_row(f"attachment {name}", f"{size} bytes")
    Console(markup=False).print(table)
