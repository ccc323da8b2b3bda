"""The verb `inteco-abs repeat`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

import click

from inteco_abs.cli.dry_run import Condition, Planned, check_start, dry_run_option, refuse_start
from inteco_abs.cli.options import (
    FILE,
    INTERRUPTED,
    LOSSES,
    Finite,
    RunOptions,
    Whole,
    json_option,
    require_different,
    run_options,
)
from inteco_abs.cli.run import brake, checked_replay, report_end
from inteco_abs.cli.terminal import print_json, say, show
from inteco_abs.errors import AbsError, ConfigError

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.experiment import Plan

_COOL_DOWN_S: Final = 30.0
"""What the manual asks for after a switch-off for heat (docs/facts/rig.md#how-the-rig-is-run)."""
_WORDS: Final = {
    0: "completed",
    LOSSES: "completed, with overruns or losses",
    5: "safety stop",
    INTERRUPTED: "interrupted",
}


@click.command()
@click.argument("count", metavar="N", type=Whole(1, 1000))
@click.option("-o", "--out", "folder", type=FILE, help="Folder for the sessions; default: sessions/series-TIME.")
@click.option(
    "--pause",
    "pause_s",
    type=Finite(0, 3600, unit="s"),
    help=f"Seconds for the brake to cool between stops; default: {_COOL_DOWN_S:g} on a real board, else 0.",
)
@click.option("--figure", type=FILE, help="Also draw all stops over one another: .png, .svg or .pdf.")
@click.option(
    "--learn",
    is_flag=True,
    help="Let each stop begin with what the observer learnt of the brake in the one before: keys of model.identified.",
)
@run_options()
@dry_run_option
@json_option
def repeat(
    count: int,
    folder: Path | None,
    pause_s: float | None,
    figure: Path | None,
    learn: bool,
    options: RunOptions,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Brake N times and show how much the stops differ.

    Each stop is a session, and the mock board's seed rises by one from stop to stop. The series ends with the first
    stop that does not complete; its results so far are printed. Exit codes: that of such a stop (5 safety stop, 130
    interrupted), 3 if stops had overruns or losses, else 0.
    """
    from inteco_abs.boards import simulated
    from inteco_abs.sessions import ensured_directory
    from inteco_abs.views.figure import check_figure

    places: list[Condition] = [partial(check_figure, figure)] if figure is not None else []
    places.append(partial(require_different, {"--out": folder, "--figure": figure}))
    pause_s = pause_s if pause_s is not None else 0.0 if simulated(options.board) else _COOL_DOWN_S
    folder = folder or Path("sessions") / f"series-{datetime.now().astimezone():%Y%m%d-%H%M%S-%f}"
    if dry_run:
        return _rehearse(count, folder, pause_s, places, options, learn=learn, as_json=as_json)
    for condition in places:
        condition()
    with ensured_directory(folder, new=True):
        worst, paths = _brake(count, folder, pause_s, options, learn=learn)
    _report(paths, figure, as_json=as_json)
    return worst


def _brake(count: int, folder: Path, pause_s: float, options: RunOptions, *, learn: bool) -> tuple[int, list[Path]]:
    """The series: the worst exit code, and the sessions that it recorded."""
    worst, paths, learnt = 0, list[Path](), list[str]()
    for number in range(count):
        if number and pause_s:
            say(f"{pause_s:g} s for the brake to cool; Ctrl-C ends the series", err=True)
            try:
                time.sleep(pause_s)
            except KeyboardInterrupt:
                return INTERRUPTED, paths
        path = _session(folder, number + 1, count)
        settings = (*options.settings, *learnt)
        rig, plan = replace(options, seed=options.seed + number, settings=settings).plan(path)
        if learn:
            _require_learning(rig)
        stop = brake(rig, plan, options)
        report_end(stop)
        problem = checked_replay(rig, plan, stop)
        if problem:
            say(f"inteco-abs: {path}: {problem}", err=True)
        if path.exists():
            paths.append(path)
        say(f"{path}: {_WORDS.get(stop.exit_code, f'ended with exit code {stop.exit_code}')}", err=True)
        worst = max(worst, stop.exit_code)
        if stop.exit_code not in {0, LOSSES}:
            break
        if learn:
            learnt = _learnt(rig, plan, path)
            say(f"learnt: {' '.join(f'--set {setting}' for setting in learnt)}", err=True)
    return worst, paths


def _learnt(rig: RigConfig, plan: Plan, path: Path) -> list[str]:
    """What the stop's observer learnt, as settings."""
    from inteco_abs.analysis import decisions
    from inteco_abs.control import build_pipeline
    from inteco_abs.sessions import read_session

    pipeline = build_pipeline(rig, plan.controllers)
    decisions(read_session(path), pipeline)
    learnt: Mapping[str, float] = cast(Any, pipeline.estimator).learnt
    return [f"model.identified.{key}={value!r}" for key, value in learnt.items()]


def _require_learning(rig: RigConfig) -> None:
    from inteco_abs.control import ESTIMATORS

    learning = [name for name, spec in ESTIMATORS.items() if hasattr(spec.works, "learnt")]
    if rig.estimator.name not in learning:
        problem = f"{rig.estimator.name} learns nothing of the brake; use --estimator {' or '.join(learning)}"
        raise ConfigError.of("--learn", problem)


def _rehearse(
    count: int,
    folder: Path,
    pause_s: float,
    places: list[Condition],
    options: RunOptions,
    *,
    learn: bool,
    as_json: bool,
) -> int:
    places.insert(0, partial(_check_new, folder))
    try:
        rig, plan = options.plan(_session(folder, 1, count))
        if learn:
            _require_learning(rig)
    except ConfigError as error:
        return refuse_start(places, error, as_json=as_json)
    return check_start([Planned(rig, plan, count)], places, pause_s=pause_s, as_json=as_json)


def _check_new(folder: Path) -> None:
    from inteco_abs.sessions import check_folder

    if folder.exists():
        raise ConfigError.of("--out", f"{folder}: exists already; name a folder that does not exist")
    check_folder(folder)


def _session(folder: Path, number: int, count: int) -> Path:
    return folder / f"stop-{number:0{len(str(count))}}.mcap"


def _report(paths: list[Path], figure: Path | None, *, as_json: bool) -> None:
    """Print statistics over the recorded stops, and draw their curves."""
    from inteco_abs.analysis import metric_statistics
    from inteco_abs.sessions import card_of, read_session
    from inteco_abs.views.series import draw_series, render_series

    cards = [card for path in paths if (card := card_of(read_session(path))) is not None]  # in memory one by one
    spreads = metric_statistics(cards)
    if as_json:
        facts = {name: spread._asdict() for name, spread in spreads.items()}
        print_json({"schema_version": 1, "stops": cards, "statistics": facts})
    else:
        show(render_series(spreads))
    if figure is not None:
        try:
            draw_series(map(read_session, paths), figure)
        except AbsError as error:  # how the stops went matters more than their picture
            say(f"inteco-abs: {error}", err=True)
        else:
            say(f"figure: {figure}", err=True)
