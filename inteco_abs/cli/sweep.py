"""The verb `inteco-abs sweep`."""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from click.core import ParameterSource

from inteco_abs.cli.completion import controller_names, estimator_names, key_names
from inteco_abs.cli.options import (
    FILE,
    LOSSES,
    Whole,
    check_table,
    json_option,
    require_different,
    shared_option,
    write_csv,
)
from inteco_abs.cli.terminal import items_progress, print_json, say, show
from inteco_abs.errors import ConfigError, ConfigIssue

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inteco_abs.montecarlo import Braked, SweepFolder, SweepRow

_NARROWEST: Final = 80
"""Columns of the table: a narrower terminal wraps lines; cutting them would lose names and digits."""
_MOST_SEEDS: Final = 20
"""Of rigs that are left out, in a message."""
_SWEEP: Final = ("rigs", "factors", "controller", "estimator", "settings", "config", "no_run_up")
_BRAKING: Final = ("jobs", "executor")
_RESULT: Final = ("table", "figure", "as_json")
_NEEDLESS: Final = {
    "work": (*_SWEEP, *_RESULT, "store", "prepare", "shown"),
    "shown": (*_SWEEP, *_BRAKING, "store", "prepare", "work", "part"),
    "prepare": (*_BRAKING, *_RESULT),
}
"""By option, those that say nothing beside it."""


def _part(_ctx: click.Context, _param: click.Parameter, text: str | None) -> tuple[int, int] | None:
    """I/N, one of N parts, counted from 1."""
    if text is None:
        return None
    index, _, count = text.partition("/")
    if not (index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
        raise click.BadParameter(f"{text!r}: must look like 3/10, the third of ten parts.")
    return int(index), int(count)


@click.command()
@click.option(
    "--rigs",
    multiple=True,
    default=("hard:0-99",),
    show_default=True,
    metavar="POPULATION:FIRST-LAST",
    help="Simulated rigs: samples of nominal, hard, rough, late, slow, capped or wild, or of a population in a .toml "
    "file, by seed; may be repeated.",
)
@click.option(
    "--factors",
    is_flag=True,
    help="Also change one number of the rigs at a time, as of a brake without lag: some 50 ranges.",
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
@click.option("--store", type=FILE, metavar="DIR", help="Keep the stops in this folder; the same command continues it.")
@click.option("--prepare", is_flag=True, help="With --store: only describe the sweep there, for --work.")
@click.option("--work", type=FILE, metavar="DIR", help="Brake what is missing in a folder of --store.")
@click.option("--part", callback=_part, metavar="I/N", help="With --work: the I-th of N parts, as of a job array.")
@click.option("--show", "shown", type=FILE, metavar="DIR", help="Show what is in a folder of --store, at any time.")
@click.option(
    "--executor",
    metavar="NAME[=ARGUMENT]",
    help="With --store or --work: brake elsewhere, as dask=tcp://host:8786, or module:callable, which makes a "
    "concurrent.futures.Executor; its workers must see DIR.",
)
@click.option("--csv", "table", type=FILE, help="Also write one line per stop (.csv).")
@click.option("--figure", type=FILE, help="Also draw the distribution of slip RMS over the stops: .png, .svg or .pdf.")
@json_option
@click.pass_context
def sweep(
    ctx: click.Context,
    rigs: tuple[str, ...],
    factors: bool,
    controller: tuple[str, ...],
    estimator: tuple[str, ...],
    settings: tuple[str, ...],
    config: Path | None,
    no_run_up: bool,
    jobs: int | None,
    store: Path | None,
    prepare: bool,
    work: Path | None,
    part: tuple[int, int] | None,
    shown: Path | None,
    executor: str | None,
    table: Path | None,
    figure: Path | None,
    as_json: bool,
) -> int:
    """Compare controllers on many simulated rigs.

    Every combination of controllers, gains and estimators brakes every rig once, from the start speed to standstill,
    and is judged by the true slip. The whole guard applies, and its trip ends a stop; rigs of the population capped
    have a brake limit of their own, and only those that can hold slip 0.2 with a margin of 0.5 N m count.

    A sweep that is stored survives: what was braked stays when a process is killed or you press Ctrl-C, and several
    computers that share a disk can work in one folder.
    """
    from inteco_abs.api.sweep import drawn, planned_sweep
    from inteco_abs.montecarlo import SweepFolder
    from inteco_abs.views.figure import check_figure

    _require_consistent(ctx)
    require_different({"--csv": table, "--figure": figure})
    check_table(table)
    if figure is not None:
        check_figure(figure)
    if work is not None:
        folder = SweepFolder.open(work)
        code = brake_missing(folder, jobs, executor, part or (1, 1))
        _report_given_up(folder)
        say(f"inteco-abs sweep --show {work} makes the table", err=True)
        return code
    if shown is not None:
        return _report(SweepFolder.open(shown, "--show"), table, figure, as_json=as_json)
    draws = drawn(rigs, factors=factors)
    plan = planned_sweep(draws, controller, estimator, settings, config, run_up=not no_run_up)
    if prepare and store is not None:
        made = SweepFolder.make(store, plan)
        say(f"sweep {made.plan.name[:12]}: {plan.count} stops to brake: inteco-abs sweep --work {store}", err=True)
        return 0
    with nullcontext(store) if store else tempfile.TemporaryDirectory(prefix="inteco-abs-sweep-") as place:
        folder = SweepFolder.make(Path(place), plan)
        code = brake_missing(folder, jobs, executor, kept=store is not None)
        return max(code, _report(folder, table, figure, as_json=as_json))


def _require_consistent(ctx: click.Context) -> None:
    """Raise ConfigError for options that say nothing together."""
    typed = {
        param.name: param.opts[0]
        for param in ctx.command.params
        if param.name and ctx.get_parameter_source(param.name) is ParameterSource.COMMANDLINE
    }
    mistakes = [
        ConfigIssue(typed[other], f"changes nothing with {typed[mode]}; leave one of them out")
        for mode in _NEEDLESS
        if mode in typed
        for other in _NEEDLESS[mode]
        if other in typed
    ]
    if "part" in typed and "work" not in typed:
        mistakes.append(ConfigIssue("--part", "needs --work DIR, the folder of which it is a part"))
    if "prepare" in typed and "store" not in typed:
        mistakes.append(ConfigIssue("--prepare", "needs --store DIR, the folder to describe the sweep in"))
    if "executor" in typed and not {"store", "work"} & set(typed):
        mistakes.append(ConfigIssue("--executor", "needs --store DIR or --work DIR, a folder that its workers see"))
    if mistakes:
        raise ConfigError(mistakes)


def brake_missing(
    folder: SweepFolder, jobs: int | None, executor: str | None, part: tuple[int, int] = (1, 1), *, kept: bool = True
) -> int:
    """Brake what is missing; the exit code."""
    from inteco_abs.api.sweep import executor_of
    from inteco_abs.montecarlo import work

    plan = folder.plan
    end = "Ctrl-C keeps what is done, and the same command continues" if kept else "Ctrl-C ends without a result"
    say(f"combinations: {len(plan.grid)}, stops to brake: {plan.count}; {end}", err=True)
    began = time.monotonic()
    with redirect_stdout(sys.stderr):
        where, ahead, jobs = executor_of(plan, jobs, executor)
        with _ended_by_sigterm(), where, items_progress() as progress:
            braked = work(folder, where, ahead, part, progress)
    _say_braked(braked, jobs, time.monotonic() - began)
    return LOSSES if braked.failed else 0


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """SIGTERM ends the sweep as Ctrl-C does, so that its processes are ended in order; only the exit code differs."""
    terminated = False

    def interrupt(*_: object) -> None:
        nonlocal terminated
        terminated = True
        raise KeyboardInterrupt  # of which no controller makes an error of its stop

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    except KeyboardInterrupt:
        if terminated:
            sys.exit(128 + signal.SIGTERM)
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


def _say_braked(braked: Braked, jobs: int, elapsed_s: float) -> None:
    stops, ticks, _ = braked
    say(
        f"{stops} {'stop' if stops == 1 else 'stops'}, {ticks} ticks in {elapsed_s:.1f} s: "
        f"{ticks / elapsed_s:.0f} ticks/s on {jobs} {'processes' if jobs > 1 else 'process'}",
        err=True,
    )


def _report(folder: SweepFolder, table: Path | None, figure: Path | None, *, as_json: bool) -> int:
    """Print and write the result, as far as there is one; the exit code."""
    from inteco_abs.api.sweep import Sweep

    result, found = Sweep(folder), folder.rows()
    rows = result.rows
    done = sum(row.stops + len(row.left_out) for row in found)
    if done < folder.plan.count:
        say(f"inteco-abs: {done} of {folder.plan.count} stops so far", err=True)
    _report_given_up(folder)
    _report_left_out(found)
    # before the files: one that cannot be written must not cost the result
    if as_json:
        print_json({"schema_version": 1, "rows": result.facts()})
    else:
        show(result, width=_NARROWEST)
    if table is not None:
        columns = list(dict.fromkeys(name for row in rows for name in row.columns))
        write_csv((record for row in rows for record in row.records()), table, columns)
    if figure is not None:
        from inteco_abs.views.figure import save_figure

        save_figure(result.plot(), figure)
        say(f"figure: {figure}", err=True)
    return _report_errors(rows)


def _report_given_up(folder: SweepFolder) -> None:
    for unit, problem in folder.failures().items():
        say(f"inteco-abs: {unit} was given up: {problem}", err=True)


def _report_left_out(rows: Sequence[SweepRow]) -> None:
    for row in {row.draws.name: row for row in rows}.values():
        if row.left_out:
            count, all_rigs = len(row.left_out), len(row.left_out) + row.stops
            more = f" and {count - _MOST_SEEDS} more" if count > _MOST_SEEDS else ""
            seeds = ", ".join(map(str, row.left_out[:_MOST_SEEDS])) + more
            say(
                f"inteco-abs: {row.draws.name}: {count} of {all_rigs} rigs are left out: they are impossible, or "
                f"cannot hold slip 0.2 with a margin of 0.5 N m: seeds {seeds}",
                err=True,
            )


def _report_errors(rows: Sequence[SweepRow]) -> int:
    """Report each row with failed stops; return the exit code."""
    code = 0
    for row in rows:
        if row.summary.failed:
            (seed, error), code = next(row.errors()), LOSSES
            say(
                f"inteco-abs: {row.combination.name}: {row.summary.failed} of {row.stops} stops failed, first "
                f"{row.draws.population}:{seed}: {error}",
                err=True,
            )
    return code
