"""The verb `inteco-abs what-if`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.options import (
    FILE,
    LOSSES,
    SESSION,
    Finite,
    RunOptions,
    json_option,
    known_controllers,
    run_options,
)
from inteco_abs.cli.replay import RECORDED, controllers_for
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import print_json, say, show
from inteco_abs.errors import ConfigError
from inteco_abs.quantities import shown

if TYPE_CHECKING:
    from inteco_abs.analysis import Continuation, WhatIf
    from inteco_abs.config import RigConfig
    from inteco_abs.plugins import Controllers
    from inteco_abs.sessions import Session
    from inteco_abs.views.what_if import WhatIfTrace

_MOST: Final = 100
_METRICS: Final = (
    "reaching_time_s", "stop_time_s", "stop_distance_m", "slip_rms_true", "slip_rms_estimated", "lock_fraction",
    "duty_variation_per_s",
)  # fmt: skip


@click.command("what-if")
@click.argument("file", type=SESSION)
@run_options(
    settings="Override a key of the session, as in controller.gains.Mk=5: of controller, estimator or model.",
    controller="Another of `inteco-abs controllers`, or your own as file.py:Class; `recorded` runs the code that the "
    "session keeps.",
    estimator="Another of `inteco-abs estimators`.",
)
@click.option(
    "--sweep",
    "sweeps",
    multiple=True,
    metavar="KEY=VALUE,VALUE...",
    help="Try each of these values, as in controller.gains.Mk=1,2,5; if repeated, all combinations.",
)
@click.option(
    "--at",
    "at_s",
    type=Finite(unit="s"),
    metavar="SECONDS",
    help="Switch this long after braking began; default: at the first tick.",
)
@click.option(
    "--duty",
    default=0.01,
    show_default=True,
    type=Finite(0),
    help="Largest difference of the commanded duty from the log that counts as equal.",
)
@click.option(
    "--torque",
    default=0.1,
    show_default=True,
    type=Finite(0, unit="N m"),
    help="Largest difference of the commanded torque that counts as equal, N m.",
)
@click.option(
    "--closed-loop",
    is_flag=True,
    help="Also continue in closed loop on the simulated rig; the default of --at is then 0.",
)
@click.option("--figure", type=FILE, help="Also draw log and alternatives: .png, .svg or .pdf.")
@json_option
def what_if(
    file: Path,
    options: RunOptions,
    sweeps: tuple[str, ...],
    at_s: float | None,
    duty: float,
    torque: float,
    closed_loop: bool,
    figure: Path | None,
    as_json: bool,
) -> int:
    """Show what other gains or controllers would have commanded.

    They get the logged counts, which do not react: after their commands leave the log (the horizon), the result is
    what they would command, not what would happen. With --closed-loop the rig's simulation continues from the logged
    state: the session's own rig if it was simulated, else the published one, with the same delay of one tick.

    Exit codes: 0 done, 3 done with a session that was cut, 1 the session cannot be used, 2 wrong usage.
    """
    from inteco_abs.sessions import read_session
    from inteco_abs.views.figure import check_figure
    from inteco_abs.views.what_if import MOST, WhatIfTrace, draw_what_if

    recorded = options.controller == RECORDED
    chosen = replace(options, controller=None) if recorded else options  # the session's own name stays
    grid = list(_grid((*chosen.chosen, *options.settings), sweeps))
    if figure is not None:
        check_figure(figure)
        if len(grid) > MOST:
            problem = f"{len(grid)} alternatives: a figure shows at most {MOST}; sweep fewer values, or omit --figure"
            raise ConfigError.of("--figure", problem)
    session = read_whole(file, read_session)
    controllers = controllers_for(session, RECORDED) if recorded else known_controllers(options.controller)
    ways = at_s, (duty, torque), closed_loop
    alternatives = [
        WhatIfTrace(name, *_ask(session, given, controllers, *ways, keep=figure is not None)) for name, given in grid
    ]
    own = _own_error(session, controllers, at_s) if closed_loop else None
    if figure is not None:
        draw_what_if(session, alternatives, figure)
        say(f"figure: {figure}", err=True)
    report = _report(session, alternatives, own)
    if as_json:
        print_json(report)
    else:
        _print(report)
    return LOSSES if session.incomplete else 0


def _grid(settings: Sequence[str], sweeps: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Name and settings of each alternative. Raises ConfigError for none or too many."""
    axes = [_axis(sweep) for sweep in sweeps]
    count = 1
    for axis in axes:
        count *= len(axis)
    if count > _MOST:
        raise ConfigError.of("--sweep", f"{count} alternatives: must be at most {_MOST}; give fewer values")
    if not (settings or axes):
        problem = "nothing to compare: name other gains, as controller.gains.Mk=5, or a --controller or --estimator"
        raise ConfigError.of("--set", problem)
    for values in product(*axes):
        yield ", ".join(values or settings), [*settings, *values]


def _axis(sweep: str) -> list[str]:
    key, equals, text = sweep.partition("=")
    values = [value.strip() for value in text.split(",")]
    if not (equals and key.strip() and all(values)):
        raise ConfigError.of(f"--sweep {sweep}", "must look like controller.gains.Mk=1,2,5")
    return [f"{key.strip()}={value}" for value in dict.fromkeys(values)]


def _ask(
    session: Session,
    settings: list[str],
    controllers: Controllers,
    at_s: float | None,
    thresholds: tuple[float, float],
    closed_loop: bool,
    *,
    keep: bool,
) -> tuple[WhatIf, Continuation | None]:
    from inteco_abs.analysis import alternative
    from inteco_abs.analysis import what_if as ask

    other = alternative(session, settings, controllers)
    closed = _continued(session, other, controllers, at_s) if closed_loop else None
    at_s = 0.0 if closed_loop and at_s is None else at_s
    return ask(session, other, controllers, at_s, *thresholds, keep=keep), closed


def _continued(session: Session, other: RigConfig, controllers: Controllers, at_s: float | None) -> Continuation:
    from inteco_abs.analysis import continued
    from inteco_abs.sessions import session_config

    return continued(session, session_config(session, ()), other, controllers, at_s or 0.0)


def _own_error(session: Session, controllers: Controllers, at_s: float | None) -> dict[str, Any] | None:
    """How far the simulation leaves the log with the session's own controller; None if it is not available."""
    from inteco_abs.analysis import distance
    from inteco_abs.sessions import session_config

    own = session_config(session, ())
    if own.controller.name not in controllers:
        return None
    return distance(session, _continued(session, own, controllers, at_s))


def _report(session: Session, alternatives: Sequence[WhatIfTrace], own: dict[str, Any] | None) -> dict[str, Any]:
    from dataclasses import asdict

    from inteco_abs.sessions import result_card, session_config

    report: dict[str, Any] = {
        "schema_version": 1,
        "session": str(session.path),
        "incomplete": session.incomplete,
        "alternatives": [
            {
                "name": each.name,
                "horizon_s": each.open_loop.horizon_s,
                "open_loop": [asdict(one) for one in each.open_loop.divergences],
                "closed_loop": _of_closed_loop(session, each.closed_loop),
            }
            for each in alternatives
        ],
    }
    if alternatives[0].closed_loop is not None:
        card = result_card(session_config(session, ()), session.ticks, session.truth)
        first = alternatives[0].closed_loop
        report["simulation"] = {
            "rig": first.rig,
            "from_tick": int(session.ticks["tick"][first.row]),
            "state_from": first.state_from,
            "own_error": own,
            "log": {name: card[name] for name in _METRICS},
        }
    return report


def _of_closed_loop(session: Session, closed: Continuation | None) -> dict[str, Any] | None:
    from inteco_abs.analysis import distance
    from inteco_abs.signals import Reason

    if closed is None:
        return None
    return {
        "reason": Reason(int(closed.ticks["reason"][-1])).name,
        "card": {name: closed.card[name] for name in _METRICS},
        "from_the_log": distance(session, closed),
    }


def _print(report: dict[str, Any]) -> None:
    from inteco_abs.views.what_if import render_what_if

    show(render_what_if(report))
    simulation = report.get("simulation")
    if simulation is None:
        say("open loop: the logged counts do not react; after the horizon this is not what would have happened")
        return
    own = simulation["own_error"]
    error = (
        "not available" if own is None else ", ".join(f"{name} {shown(value, '.4g')}" for name, value in own.items())
    )
    say(
        f"closed loop: a SIMULATION of the rig {simulation['rig']} from tick {simulation['from_tick']} on, its state "
        f"from the {simulation['state_from']}; with the session's own controller it leaves the log by: {error}"
    )
