"""The verb `inteco-abs sweep`."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Final

import click

from inteco_abs.cli.completion import controller_names, estimator_names, key_names
from inteco_abs.cli.options import (
    FILE,
    LOSSES,
    Whole,
    check_table,
    json_option,
    known_controllers,
    require_different,
    shared_option,
    write_csv,
)
from inteco_abs.cli.terminal import print_json, say, show, stops_progress
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from inteco_abs.montecarlo import Combination, SampleSet, SweepRow
    from inteco_abs.plugins import Controllers

_SMALLEST_SHARD: Final = 5
_SHARDS_PER_JOB: Final = 4
"""At least, so that no process waits long for the last one."""
_NARROWEST: Final = 80
"""Columns of the table: a narrower terminal wraps lines; cutting them would lose names and digits."""


@click.command()
@click.option(
    "--rigs",
    multiple=True,
    default=("hard:0-99",),
    show_default=True,
    metavar="POPULATION:FIRST-LAST",
    help="Simulated rigs: samples of nominal, hard, rough, late, slow or capped, by seed; may be repeated.",
)
@click.option(
    "--controller", multiple=True, shell_complete=controller_names, help="As for run; several by commas or repeated."
)
@click.option(
    "--estimator",
    multiple=True,
    shell_complete=estimator_names,
    help="As for run, or ideal, which knows the true slip; several by commas or repeated.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    shell_complete=key_names,
    metavar="KEY=VALUE,VALUE...",
    help="Override a key, as in controller.gains.Mk=2,5,10: all combinations; a gain applies to controllers with it.",
)
@shared_option("config")
@click.option("--no-run-up", is_flag=True, help="Begin at the start speed with rolling wheels and no drive.")
@click.option("--jobs", type=Whole(1, 1024), help="Number of processes; default: one per core.")
@click.option("--csv", "table", type=FILE, help="Also write one line per stop (.csv).")
@click.option("--figure", type=FILE, help="Also draw the distribution of slip RMS over the stops: .png, .svg or .pdf.")
@json_option
def sweep(
    rigs: tuple[str, ...],
    controller: tuple[str, ...],
    estimator: tuple[str, ...],
    settings: tuple[str, ...],
    config: Path | None,
    no_run_up: bool,
    jobs: int | None,
    table: Path | None,
    figure: Path | None,
    as_json: bool,
) -> int:
    """Compare controllers on many simulated rigs.

    Every combination of controllers, gains and estimators brakes every rig once, from the start speed to standstill,
    and is judged by the true slip. The whole guard applies, and its trip ends a stop; rigs of the population capped
    have a brake limit of their own, and only those that can hold slip 0.2 with a margin of 0.5 N m count.
    """
    from inteco_abs.montecarlo import SHARD, combinations, parse_draws
    from inteco_abs.montecarlo import sweep as sweep_all
    from inteco_abs.views.figure import check_figure

    draws = [parse_draws(text) for text in dict.fromkeys(rigs)]
    with redirect_stdout(sys.stderr):  # a controller's prints must not mix with the result
        controllers, sources = _controllers(controller)
    chosen = [f"controller.name={name}" for name in controller] + [f"estimator.name={name}" for name in estimator]
    grid = combinations([*settings, *chosen], controllers, config)
    require_different({"--csv": table, "--figure": figure})
    _require_no_rig(grid, draws)
    check_table(table)
    if figure is not None:
        check_figure(figure)
    _report_left_out(draws)
    stops = len(grid) * sum(len(each.rigs) for each in draws)
    jobs = min(jobs or _cores(), -(-stops // _SMALLEST_SHARD))
    say(f"combinations: {len(grid)}, stops to brake: {stops}; Ctrl-C ends without a result", err=True)
    began = time.monotonic()
    with redirect_stdout(sys.stderr), _processes(jobs) as executor, stops_progress() as progress:
        rows = sweep_all(
            grid,
            draws,
            sources=sources,
            run_up=not no_run_up,
            executor=executor,
            shard=max(_SMALLEST_SHARD, min(SHARD, stops // (_SHARDS_PER_JOB * jobs))),
            progress=progress,
        )
    ticks, elapsed_s = sum(row.stops.ticks for row in rows), time.monotonic() - began
    say(
        f"{stops} {'stops' if stops > 1 else 'stop'}, {ticks} ticks in {elapsed_s:.1f} s: "
        f"{ticks / elapsed_s:.0f} ticks/s on {jobs} {'processes' if jobs > 1 else 'process'}",
        err=True,
    )
    # before the files: one that cannot be written must not cost the result
    if as_json:
        print_json({"schema_version": 1, "rows": [row.facts() for row in rows]})
    else:
        from inteco_abs.montecarlo.table import render_sweep

        show(render_sweep(rows), width=_NARROWEST)
    if table is not None:
        write_csv([record for row in rows for record in row.records()], table)
    if figure is not None:
        from inteco_abs.montecarlo.table import draw_sweep

        draw_sweep(rows, figure)
        say(f"figure: {figure}", err=True)
    return _report_errors(rows)


def _controllers(names: Sequence[str]) -> tuple[Controllers, dict[str, bytes]]:
    """All known controllers, and the sources of those from the user's files."""
    from inteco_abs.montecarlo import split_list
    from inteco_abs.plugins import FROM_FILE
    from inteco_abs.plugins import Controllers as Known

    own = {}
    for name in (one.strip() for text in names for one in split_list(text)):
        known = known_controllers(name)
        if FROM_FILE in name:
            own[name] = known[name], known.origin(name)
    return Known(own), {name: origin.source for name, (_, origin) in own.items()}


def _require_no_rig(grid: Sequence[Combination], draws: Sequence[SampleSet]) -> None:
    """Raise ConfigError if the configuration describes a rig, as --rigs does."""
    from inteco_abs.config import SimulationConfig

    mistakes = []
    if any(one.config.simulation != SimulationConfig() for one in grid):
        mistakes.append(ConfigIssue("simulation", "a sweep brakes the rigs of --rigs; leave this section out"))
    configured = {one.config.encoders.counts_per_turn for one in grid}
    drawn = {rig.road_encoder.counts_per_turn for each in draws for rig in each.rigs}
    if configured != drawn:
        shown = ", ".join(map(str, sorted(configured - drawn)))
        mistakes.append(ConfigIssue("encoders.counts_per_turn", f"{shown}: these rigs have {max(drawn)}; leave it out"))
    if mistakes:
        raise ConfigError(mistakes)


def _report_left_out(draws: Sequence[SampleSet]) -> None:
    for each in draws:
        if each.left_out:
            count = len(each.left_out) + len(each.seeds)
            say(
                f"inteco-abs: {each.name}: {len(each.left_out)} of {count} rigs are left out: they cannot hold slip "
                f"0.2 with a margin of 0.5 N m: seeds {', '.join(map(str, each.left_out))}",
                err=True,
            )


def _report_errors(rows: Sequence[SweepRow]) -> int:
    """Report each row with failed stops; return the exit code."""
    code = 0
    for row in rows:
        failed = [(seed, error) for seed, error in zip(row.draws.seeds, row.stops.errors, strict=True) if error]
        if failed:
            (seed, error), code = failed[0], LOSSES
            say(
                f"inteco-abs: {row.combination.name}: {len(failed)} of {len(row.stops)} stops failed, first "
                f"{row.draws.population}:{seed}: {error}",
                err=True,
            )
    return code


def _cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _processes(jobs: int) -> Iterator[Executor | None]:
    """A pool of this many processes; None if this process is enough."""
    if jobs == 1:
        yield None
        return
    from concurrent.futures import ProcessPoolExecutor
    from concurrent.futures.process import BrokenProcessPool
    from multiprocessing import active_children, get_context

    # spawned: a forked copy of a process with threads, as the progress bar's, may hang
    with ProcessPoolExecutor(jobs, get_context("spawn"), _begin_worker) as pool:
        try:
            yield pool
        except KeyboardInterrupt:
            for worker in active_children():  # the pool would wait for their work
                worker.terminate()
            raise
        except BrokenProcessPool as error:
            raise AbsError("a process of the sweep died, perhaps of too little memory; try --jobs 1") from error


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, send prints to stderr, and end when the parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.stdout = sys.stderr
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    from multiprocessing import parent_process

    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
