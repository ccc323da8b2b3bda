"""The verb `inteco-abs replay`, and which controllers a session is replayed with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.options import DIFFERS, LOSSES, SESSION, json_option, known_controllers
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import print_json, say
from inteco_abs.errors import ConfigError, describe_error, near_match

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inteco_abs.analysis import Replay, Shift
    from inteco_abs.plugins import Controllers, Origin
    from inteco_abs.sessions import Session

RECORDED: Final = "recorded"
"""What `--controller` names for the code that the session keeps."""


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

    from inteco_abs.analysis import (
        before_the_gap,
        changed_gains,
        parse_tolerances,
        recorded_arithmetic,
        replay_session,
        require_known,
    )
    from inteco_abs.control import REFERENCE, build_pipeline, control_check, gains_in_force
    from inteco_abs.sessions import read_session, session_config

    given = parse_tolerances(tolerances)
    recorded = read_whole(file, read_session)
    require_known(recorded)
    session = before_the_gap(recorded)
    left_out = recorded.tick_count - session.tick_count
    controllers = controllers_for(session, controller)
    config = session_config(session, (control_check(controllers),))
    gains = changed_gains(session, {REFERENCE: config.controller.reference_slip, **gains_in_force(config, controllers)})
    with recorded_arithmetic(session):
        pipeline = build_pipeline(config, controllers)
        outcome = replay_session(session, pipeline, given)
    report = {
        "schema_version": 1,
        "session": str(file),
        "incomplete": session.incomplete,
        "left_out": left_out,
        **asdict(outcome),
        "gains": gains,
        "tolerances": {name: asdict(tolerance) for name, tolerance in given.items()},
    }
    if as_json:
        print_json(report)
    else:
        _print_replay(file, outcome, gains)
    if outcome.differing and pipeline.error is not None:
        say(f"inteco-abs: the controller or estimator failed in the replay: {describe_error(pipeline.error)}", err=True)
    if left_out:
        say(f"inteco-abs: {file}: {left_out} ticks after a gap cannot be replayed", err=True)
    return DIFFERS if outcome.differing or gains else LOSSES if session.incomplete or left_out else 0


def controllers_for(session: Session, controller: str | None) -> Controllers:
    """Controllers with the session's among them, or `controller` in its place. Raises ConfigError if there is none."""
    from inteco_abs.plugins import FROM_FILE, Controllers

    recorded = session.metadata.get("controller", {})
    name, package = recorded.get("name", ""), recorded.get("package", "")
    if controller == RECORDED:
        return _kept_controllers(session, name)
    controllers = known_controllers(controller)
    if controller is not None:
        if controller not in controllers:
            raise ConfigError.of("--controller", f"no controller {controller!r}{near_match(controller, controllers)}")
        controllers = Controllers({name: (controllers[controller], controllers.origin(controller))})
    elif FROM_FILE in name:
        hint = f"name that file to replay it, or {RECORDED} to run the code that the session keeps"
        problem = f"the session was run with {name!r}; {hint}"
        raise ConfigError.of("--controller", problem)
    elif package and name not in controllers:
        problem = f"the session was run with {name!r} of the package {package!r}, which is not installed; install it"
        raise ConfigError.of("--controller", problem)
    if name in controllers:
        _report_other(controllers.origin(name), _kept_source(session), package)
    return controllers


def _kept_controllers(session: Session, name: str) -> Controllers:
    """The session's own controller, from the code and files that it keeps. Raises ConfigError if there is none."""
    from inteco_abs.experiment import time_limit
    from inteco_abs.plugins import FROM_FILE, Controllers, Origin, load_controller

    source = _kept_source(session)
    if FROM_FILE not in name or source is None:
        problem = f"{RECORDED}: {session.path} keeps no controller of a file; leave the option out"
        raise ConfigError.of("--controller", problem)
    with time_limit():
        kind, _ = load_controller(name, source)
    return Controllers({name: (kind, Origin(source))})


def _kept_source(session: Session) -> bytes | None:
    """Source of the session's controller, with the files beside it if there are."""
    from inteco_abs.sessions import CONTROLLER_FILES, CONTROLLER_SOURCE

    return session.attachments.get(CONTROLLER_FILES, session.attachments.get(CONTROLLER_SOURCE))


def _report_other(origin: Origin, source: bytes | None, package: str) -> None:
    """Warn if the controller is not the one that the session was run with."""
    from inteco_abs.plugins import differs

    if package not in {"", origin.package}:
        say(
            f"inteco-abs: the session was run with {package}; this is {origin.package or 'another controller'}",
            err=True,
        )
    if source is not None and differs(origin.source, source):
        say("inteco-abs: the controller's source differs from the session's", err=True)


def _print_replay(file: Path, outcome: Replay, gains: Mapping[str, Any]) -> None:
    from inteco_abs.sessions import describe_other_arithmetic

    for name, change in gains.items():
        was, now = (change[when] or "not there" for when in ("recorded", "configured"))
        say(f"{file}: the gain {name} was {was} in the run ({change['where']}) and is {now} now")
    within = f", {max(outcome.tolerated.values())} within their tolerance" if outcome.tolerated else ""
    if outcome.first is None:
        ticks = f"{outcome.ticks} ticks ({outcome.braking_ticks} braking)"
        say(f"{file}: {ticks} replayed, none differ{within}")
    else:
        first = outcome.first
        say(f"{file}: {outcome.differing} of {outcome.ticks} ticks differ, first at tick {first.tick}: {first.field}")
        say(f"  logged   {first.logged}  {first.logged_hex}")
        say(f"  replayed {first.replayed}  {first.replayed_hex}")
        say(f"  before it {outcome.agreeing_ticks} ticks agree, {outcome.agreeing_s:.4f} s")
        for name, count in outcome.by_field.items():
            say(f"  {name}: {count} ticks")
    for shift in outcome.shifts:
        say(f"  {_words(shift)}")
    if outcome.arithmetic:
        say(f"  {describe_other_arithmetic(outcome.arithmetic)}")


def _words(shift: Shift) -> str:
    change = f"{shift.field} becomes {shift.value}"
    if shift.late_ticks is None:
        where = ("in the log", shift.logged_tick) if shift.replayed_tick is None else ("replayed", shift.replayed_tick)
        return f"{change} only {where[0]}, at tick {where[1]}"
    ticks = abs(shift.late_ticks)
    count = f"{ticks} tick{'s' if ticks > 1 else ''}"
    return f"{change} {count} {'late' if shift.late_ticks > 0 else 'early'}, at tick {shift.replayed_tick}"
