"""The verb `inteco-abs run`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from inteco_abs.cli.dry_run import Condition, Planned, check_start, dry_run_option, refuse_start
from inteco_abs.cli.options import FILE, INTERRUPTED, RunOptions, json_option, require_different, run_options
from inteco_abs.cli.screens import screen_of
from inteco_abs.cli.session_files import draw
from inteco_abs.cli.terminal import print_card, print_json, say
from inteco_abs.errors import AbsError, ConfigError

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.experiment import Plan
    from inteco_abs.realtime import Screen
    from inteco_abs.sessions import RunResult


@click.command()
@run_options()
@click.option("--out", "-o", type=FILE, help="Session file to write; default: sessions/stop-TIME.mcap.")
@click.option("--figure", type=FILE, help="Also draw the stop: .png, .svg or .pdf.")
@click.option(
    "--record-wire", "wire", type=FILE, help="Also write the board's messages, at most 300000, as JSON lines."
)
@click.option(
    "--frames",
    is_flag=True,
    help="Also keep the board's messages in the session, for `inteco-abs wire`: at most 300000 (50 s at 2 kHz), which "
    "take 2 MB/s of memory and 0.2 MB/s of the file.",
)
@click.option(
    "--stdio",
    is_flag=True,
    help="For programs: write the run as JSON lines to standard output while it lasts; obey lines of standard input: "
    "stop, or NAME=VALUE for a gain. Its end stops the run.",
)
@dry_run_option
@json_option
def run(
    options: RunOptions,
    out: Path | None,
    figure: Path | None,
    wire: Path | None,
    frames: bool,
    stdio: bool,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Brake once and record the session."""
    as_json = as_json or stdio
    places = list(_places(out, figure, wire))
    session = out or Path("sessions") / f"stop-{datetime.now().astimezone():%Y%m%d-%H%M%S-%f}.mcap"
    try:
        rig, plan = options.plan(session, wire=wire, frames=frames)
    except ConfigError as error:
        if dry_run:
            return refuse_start(places, error, as_json=as_json)
        raise
    if dry_run:
        return check_start([Planned(rig, plan)], [*_folder(out, plan), *places], as_json=as_json)
    for condition in places:
        condition()
    stop = brake(rig, plan, options, stdio=stdio)
    try:
        if as_json:
            problem = checked_replay(rig, plan, stop)
            card = stop.card | ({"replay_problem": problem} if problem else {})
            print_json({"card": card} if stdio else card)
        elif not options.quiet:
            from inteco_abs.analysis import previous_card

            print_card(stop.card, stop.explanation, previous_card(stop.card))
        report_end(stop)
        problem = problem if as_json else checked_replay(rig, plan, stop)  # the card does not wait for it
        if problem:
            say(f"inteco-abs: {problem}", err=True)
    except OSError:  # the terminal is gone; the exit code still counts
        sys.stdout = sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115  until the process ends
        return stop.exit_code or 1
    return _drawn(stop, figure)


def checked_replay(rig: RigConfig, plan: Plan, stop: RunResult) -> str:
    """Why the run will not replay; an interrupt ends the check, as the run is over."""
    from inteco_abs.experiment import replay_problem

    try:
        return replay_problem(rig, plan, stop)
    except KeyboardInterrupt:
        return f"interrupted while checking whether the decisions replay; {stop.card['session']} is complete"


def brake(rig: RigConfig, plan: Plan, options: RunOptions, *, stdio: bool = False) -> RunResult:
    """Run one stop with a screen, or for the program that started this one."""
    from inteco_abs.experiment import run_stop
    from inteco_abs.sessions import ensured_directory

    if not plan.virtual:
        _report_left_rings()
    tuner = None
    if options.tune or (stdio and not plan.virtual):
        from inteco_abs.realtime import Tuner

        tuner = Tuner()
    screen: AbstractContextManager[Screen]
    if stdio:
        from inteco_abs.views.json_lines import JsonLines

        screen = nullcontext(JsonLines(sys.stdout, 0, tuner))
    else:
        screen = screen_of(rig, options.live, virtual=plan.virtual, quiet=options.quiet, tuner=tuner)
    with ensured_directory(plan.out.parent), screen as shown:
        return run_stop(rig, plan, screen=shown, tuner=tuner)


def report_end(stop: RunResult) -> None:
    """Report on stderr how a stop ended, if not as usual."""
    for fault, times in stop.injected.items():
        acted = "never acted: was the run over before?" if times == "0" else f"acted {times} times"
        say(f"inteco-abs: injected {fault}: {acted}", err=True)
    for change in stop.not_made:
        say(f"inteco-abs: the change {change} was not made: the run was over before", err=True)
    if stop.outcome != "completed":
        safe = f"; drive and brake are off after tick {stop.card['ticks'] - 1}" if stop.outcome == "fault" else ""
        say(f"inteco-abs: {stop.outcome}: {stop.explanation}{safe}", err=True)
    if stop.trouble:
        say(f"inteco-abs: {stop.trouble}", err=True)
    elif stop.outcome == "completed" and stop.exit_code:
        lost = f"{stop.card['overruns']} periods overrun, {stop.card['link_errors']} exchanges failed"
        say(f"inteco-abs: completed with problems: {lost}", err=True)


def _drawn(stop: RunResult, figure: Path | None) -> int:
    """Draw the figure, if asked for and the stop braked; return the exit code."""
    if figure is None or stop.card["start_speed_rad_s"] is None:
        return stop.exit_code
    session = stop.card["session"]
    try:
        draw([Path(session)], figure)
    except AbsError as error:  # the run's outcome matters more than its figure
        say(f"inteco-abs: {error}", err=True)
        return stop.exit_code or error.exit_code
    except KeyboardInterrupt:
        say(f"inteco-abs: interrupted while drawing; {session} is complete: inteco-abs figure {session}", err=True)
        return stop.exit_code or INTERRUPTED
    return stop.exit_code


def _places(out: Path | None, figure: Path | None, wire: Path | None) -> Iterator[Condition]:
    """Conditions on the files that were named."""
    from inteco_abs.sessions import check_session_file
    from inteco_abs.views.figure import check_figure

    if figure is not None:
        yield partial(check_figure, figure)
    if out is not None:
        yield partial(check_session_file, out)
    yield partial(require_different, {"--out": out, "--figure": figure, "--record-wire": wire})


def _folder(out: Path | None, plan: Plan) -> Iterator[Condition]:
    """Condition on the default folder."""
    from inteco_abs.sessions import check_folder

    if out is None:
        yield partial(check_folder, plan.out.parent)


def _report_left_rings() -> None:
    """Name shared memory with ticks of a run that crashed or had no disk."""
    from inteco_abs.realtime import left_rings

    for ring in left_rings():
        say(f"inteco-abs: an earlier run left its ticks in {ring}: inteco-abs recover {ring} --out FILE", err=True)
