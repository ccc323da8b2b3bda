"""The verb `inteco-abs replay`, and which controllers a session is replayed with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from inteco_abs.cli.options import DIFFERS, LOSSES, SESSION, json_option
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import print_json, say

if TYPE_CHECKING:
    from inteco_abs.plugins import Controllers
    from inteco_abs.sessions import Session


@click.command()
@click.argument("file", type=SESSION)
@click.option(
    "--controller",
    help="Your own controller as file.py:Class, if the session was run with one; `recorded` runs the code that the "
    "session keeps.",
)
@click.option(
    "--tol",
    "tolerances",
    multiple=True,
    metavar="FIELD=ABS[:REL[:LEAD_S[:LAG_S]]]",
    help="Tolerance of an output, as in brake=1e-9:1e-6, or of the time of a flag, as in phase=::0.002:0.002; "
    "* means every output. May be repeated.",
)
@json_option
def replay(file: Path, controller: str | None, tolerances: tuple[str, ...], as_json: bool) -> int:
    """Repeat a session's decisions and compare them bit for bit.

    With --tol, an output agrees if it is within max(ABS, REL*|logged|) of the logged value, or of a value logged up
    to LEAD_S later or LAG_S earlier. All other outputs must agree exactly, and so must the recorded gains.

    Exit codes: 0 all agrees, 3 all agrees up to a gap or the end of a cut file, 4 something differs, 1 the session
    cannot be used, 2 wrong usage.
    """
    from dataclasses import asdict

    from inteco_abs.analysis import parse_tolerances, replay_recorded, require_known
    from inteco_abs.sessions import read_session

    given = parse_tolerances(tolerances)
    session = read_whole(file, read_session)
    require_known(session)
    found = replay_recorded(session, controllers_for(session, controller), given)
    if as_json:
        print_json(
            {
                "schema_version": 1,
                "session": str(file),
                "incomplete": session.incomplete,
                **asdict(found),
                "tolerances": {name: asdict(tolerance) for name, tolerance in given.items()},
            }
        )
    else:
        for line in found.lines(str(file)):
            say(line)
    if found.error:
        say(f"inteco-abs: the controller or estimator failed in the replay: {found.error}", err=True)
    if found.left_out:
        say(f"inteco-abs: {file}: {found.left_out} ticks after a gap cannot be replayed", err=True)
    return 0 if found.agrees and not (session.incomplete or found.left_out) else LOSSES if found.agrees else DIFFERS


def controllers_for(session: Session, controller: str | None) -> Controllers:
    """As `controllers_of`, with a report of what differs from the run's."""
    from inteco_abs.api.controllers import controllers_of

    controllers, others = controllers_of(session, controller)
    for other in others:
        say(f"inteco-abs: {other}", err=True)
    return controllers
