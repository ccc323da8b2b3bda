"""The verb `inteco-abs what-if`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

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
from inteco_abs.cli.replay import controllers_for
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import print_json, say, show


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
    from inteco_abs.api.controllers import RECORDED
    from inteco_abs.api.what_if import alternatives_to, grid_of
    from inteco_abs.sessions import read_session
    from inteco_abs.views.figure import check_figure, save_figure
    from inteco_abs.views.what_if import require_few

    recorded = options.controller == RECORDED
    chosen = replace(options, controller=None) if recorded else options  # the session's own name stays
    grid = list(grid_of((*chosen.chosen, *options.settings), sweeps))
    if figure is not None:
        check_figure(figure)
        require_few(len(grid))
    session = read_whole(file, read_session)
    controllers = controllers_for(session, RECORDED) if recorded else known_controllers(options.controller)
    ways = at_s, (duty, torque)
    found = alternatives_to(session, grid, controllers, *ways, closed_loop=closed_loop, keep=figure is not None)
    if figure is not None:
        save_figure(found.plot(), figure)
        say(f"figure: {figure}", err=True)
    if as_json:
        print_json(found.report())
    else:
        show(found)
        say(found.caution())
    return LOSSES if session.incomplete else 0
