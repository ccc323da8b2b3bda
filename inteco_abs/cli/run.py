"""The verb `inteco-abs run`."""

from __future__ import annotations

import os
import sys
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from inteco_abs.cli.completion import controller_names, estimator_names, key_names
from inteco_abs.cli.dry_run import Condition, Planned, dry_run_option, refuse_together, rehearse
from inteco_abs.cli.options import (
    FILE,
    INTERRUPTED,
    SETTING,
    Whole,
    check_session_file,
    draw,
    drawn_setting,
    json_option,
    known_controllers,
    print_card,
    print_json,
    require_different,
    rig_option,
    say,
)
from inteco_abs.cli.screens import live_options, screen_of
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inteco_abs.config import RigConfig
    from inteco_abs.experiment import Plan
    from inteco_abs.sessions import RunResult

_LIVE_PORT: Final = 8765
"""Where Lichtblick and Foxglove look if nobody tells them."""


@click.command()
@click.option("--board", default="sim:", show_default=True, help="Board address; sim: is the mock board.")
@click.option("--virtual", is_flag=True, help="Virtual time: as fast as it goes, and repeatable.")
@click.option(
    "--seed",
    default=0,
    show_default=True,
    type=Whole(0),
    help="What differs between two power-ups of the mock board.",
)
@rig_option
@click.option("--config", type=FILE, help="rig.toml; every key has a default.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    type=SETTING,
    shell_complete=key_names,
    metavar="KEY=VALUE",
    help="Over the file, as in guard.brake_limit=0.7.",
)
@click.option(
    "--controller",
    shell_complete=controller_names,
    help="One of `inteco-abs controllers`, or your own as file.py:Class.",
)
@click.option(
    "--estimator",
    shell_complete=estimator_names,
    help="One of `inteco-abs estimators`: moving-window, tracking, kalman, edge-time, observer, euler as in the "
    "paper, difference as by the vendor.",
)
@click.option("--out", "-o", type=FILE, help="Session file to write; default: sessions/stop-TIME.mcap.")
@click.option("--figure", type=FILE, help="Also draw the stop: .png, .svg or .pdf.")
@click.option("--record-wire", "wire", type=FILE, help="Also write every message to and from the board, as JSON lines.")
@click.option(
    "--frames",
    is_flag=True,
    help="Also keep messages to and from the board in the session, the first 300000 of them: 2 MB/s of memory for 50 s "
    "at 2 kHz, 0.2 MB/s in the file; `inteco-abs wire` reads them there.",
)
@click.option(
    "--foxglove",
    "live_port",
    is_flag=False,
    flag_value=_LIVE_PORT,
    type=Whole(0, 65535),
    metavar="[PORT]",
    help=f"Also show the run to Lichtblick or Foxglove on this computer while it lasts; default port: {_LIVE_PORT}, "
    "0 is any that is free.",
)
@click.option(
    "--inject",
    "faults",
    multiple=True,
    metavar="FAULT",
    help="Let the mock board fail, as in lose@brake+20ms or road-stuck@drive+2s; `inteco-abs faults` lists all.",
)
@live_options
@dry_run_option
@json_option
def run(
    board: str,
    virtual: bool,
    seed: int,
    drawn: str | None,
    config: Path | None,
    settings: tuple[str, ...],
    controller: str | None,
    estimator: str | None,
    out: Path | None,
    figure: Path | None,
    wire: Path | None,
    frames: bool,
    live_port: int | None,
    faults: tuple[str, ...],
    live: str | None,
    quiet: bool,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Drive, brake, record: one stop."""
    from inteco_abs.experiment import run_stop
    from inteco_abs.sessions import check_folder, ensured_directory

    places = list(_places(out, figure, wire))
    try:
        rig, plan = planned_run(
            board, virtual, seed, drawn, config, settings, controller, estimator, out, wire, frames, live_port, faults
        )
    except ConfigError as error:
        if dry_run:
            raise refuse_together(places, error) from error
        raise
    if dry_run:
        folder = () if out else (partial(check_folder, plan.out.parent),)
        return rehearse([Planned(rig, plan)], [*folder, *places], as_json=as_json)
    for condition in places:
        condition()
    if not virtual:
        _tell_of_left_rings()
    with ensured_directory(plan.out.parent), screen_of(rig, live, virtual=virtual, quiet=quiet) as screen:
        stop = run_stop(rig, plan, screen=screen)
    try:
        _tell(stop, as_json=as_json, quiet=quiet)
    except OSError:  # the terminal is gone: how the run ended matters more
        sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  until the process ends
        return stop.exit_code or 1
    if figure is not None and stop.card["start_speed_rad_s"] is not None:
        try:
            draw([Path(stop.card["session"])], figure)
        except AbsError as error:  # how the run ended matters more than its picture
            say(f"inteco-abs: {error}", err=True)
            return stop.exit_code or error.exit_code
        except KeyboardInterrupt:
            session = stop.card["session"]
            say(f"inteco-abs: interrupted while drawing; {session} is whole: inteco-abs figure {session}", err=True)
            return stop.exit_code or INTERRUPTED
    return stop.exit_code


def planned_run(
    board: str,
    virtual: bool,
    seed: int,
    drawn: str | None,
    config: Path | None,
    settings: tuple[str, ...],
    controller: str | None,
    estimator: str | None,
    out: Path | None,
    wire: Path | None = None,
    frames: bool = False,
    live_port: int | None = None,
    faults: tuple[str, ...] = (),
) -> tuple[RigConfig, Plan]:
    """What the options of a run come to; nothing is opened or made. Raises ConfigError."""
    from inteco_abs.boards import check_address, default_profile, simulated
    from inteco_abs.config import load_config
    from inteco_abs.control import control_check, preferred_estimator
    from inteco_abs.experiment import Plan
    from inteco_abs.mock_board import parse_faults, rig_check

    controllers = known_controllers(controller)
    chosen = [f"{key}.name={name}" for key, name in (("controller", controller), ("estimator", estimator)) if name]
    check_address(board)
    if drawn is not None and not simulated(board):
        raise ConfigError(
            [ConfigIssue("--rig", f"{board} is a real board, and has a rig; only sim: has one to choose")]
        )
    checks = [control_check(controllers), rig_check]
    settings = (*settings, *drawn_setting(drawn), *chosen)
    rig = load_config(config, settings, checks, default_profile(board), preferred_estimator(controllers))
    source, package = controllers.origin(rig.controller.name)
    out = out or Path("sessions") / f"stop-{datetime.now().astimezone():%Y%m%d-%H%M%S-%f}.mcap"
    injected = parse_faults(faults)
    return rig, Plan(out, board, virtual, seed, controllers, source, wire, frames, package, live_port, injected)


def _places(out: Path | None, figure: Path | None, wire: Path | None) -> Iterator[Condition]:
    """Conditions on the files that were named."""
    from inteco_abs.views.figure import check_figure

    if figure is not None:
        yield partial(check_figure, figure)
    if out is not None:
        yield partial(check_session_file, out)
    yield partial(require_different, {"--out": out, "--figure": figure, "--record-wire": wire})


def _tell(stop: RunResult, *, as_json: bool, quiet: bool) -> None:
    if as_json:
        print_json(stop.card)
    elif not quiet:
        from inteco_abs.analysis import previous_card

        print_card(stop.card, stop.explanation, previous_card(stop.card))
    for fault, times in stop.injected.items():
        acted = "never acted: was the run over before?" if times == "0" else f"acted {times} times"
        say(f"inteco-abs: injected {fault}: {acted}", err=True)
    if stop.outcome != "completed":
        safe = f"; drive and brake are off after tick {stop.card['ticks'] - 1}" if stop.outcome == "fault" else ""
        say(f"inteco-abs: {stop.outcome}: {stop.explanation}{safe}", err=True)
    if stop.trouble:
        say(f"inteco-abs: {stop.trouble}", err=True)
    elif stop.outcome == "completed" and stop.exit_code:
        lost = f"{stop.card['overruns']} periods overrun, {stop.card['link_errors']} exchanges failed"
        say(f"inteco-abs: completed, but look at it: {lost}", err=True)


def _tell_of_left_rings() -> None:
    """Ticks of a run that crashed altogether, or had no disk, are in memory; the next run must not let them be lost."""
    from inteco_abs.realtime.memory import left_rings

    for ring in left_rings():
        say(
            f"inteco-abs: an earlier run has left its ticks in {ring}: inteco-abs recover {ring} --out FILE",
            err=True,
        )
