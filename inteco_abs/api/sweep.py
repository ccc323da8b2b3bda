"""Controllers compared on many simulated rigs."""

from __future__ import annotations

import shutil
import sys
import tempfile
import weakref
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.api.arguments import speaks_of_arguments
from inteco_abs.api.configuration import as_list, chosen_settings, require_whole, varied_lines
from inteco_abs.api.controllers import user_controllers
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue
from inteco_abs.views.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from inteco_abs.montecarlo import Combination, Progress, SampleSet, SweepFolder, SweepPlan, SweepRow
    from inteco_abs.plugins import Controllers

_FEWEST_STOPS: Final = 5
"""For a process of its own."""
_AHEAD: Final = 4
"""Units for each worker, so that none waits for the next."""


class Sweep(Shown):
    """What a sweep has found, as far as it is braked: one row for each configuration on each range of rigs."""

    __slots__ = ("__weakref__", "folder")

    def __init__(self, folder: SweepFolder) -> None:
        self.folder = folder

    @property
    def rows(self) -> list[SweepRow]:
        """The rows with stops: `row["slip_rms_fixed_true"]` is one metric of all stops, `row.summary` has quantiles."""
        return [row for row in self.folder.rows() if row.stops]

    def facts(self) -> list[dict[str, Any]]:
        """The rows of `sweep --json`: medians, 99th percentiles and largest values by metric, with 90 % intervals."""
        return [row.facts() for row in self.rows]

    def to_pandas(self) -> Any:
        """One line for each stop as a pandas DataFrame, with the columns of `sweep --csv`."""
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise AbsError("a DataFrame needs pandas: pip install pandas") from error
        return DataFrame([record for row in self.rows for record in row.records()])

    def plot(self) -> Figure:
        """Share of the stops over slip RMS, a panel for each range of rigs. Raises AbsError without matplotlib."""
        from inteco_abs.montecarlo.table import figure_of_sweep

        return figure_of_sweep(self.rows)

    def __rich__(self) -> RenderableType:
        from inteco_abs.montecarlo.table import render_sweep

        return render_sweep(self.rows)

    def __repr__(self) -> str:
        done = sum(row.stops + len(row.left_out) for row in self.folder.rows())
        plan = self.folder.plan
        rigs = ", ".join(draws.name for draws in plan.draws)
        return f"<Sweep of {len(plan.grid)} configurations on {rigs}: {done} of {plan.count} stops>"


@speaks_of_arguments(set="settings", controller="controllers", estimator="estimators", executor="jobs")
def sweep(
    controllers: str | Iterable[str] = (),
    *,
    rigs: str | Iterable[str] = "hard:0-99",
    estimators: str | Iterable[str] = (),
    gains: Mapping[str, float | Sequence[float]] | None = None,
    settings: Mapping[str, Any] | None = None,
    config: str | Path | None = None,
    factors: bool = False,
    run_up: bool = True,
    jobs: int | None = None,
    store: str | Path | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Compare controllers on many simulated rigs: every combination brakes every rig once, judged by the true slip.

    `controllers` are names as on the command line, or "file.py:Class"; `rigs` are ranges such as "hard:0-99" of shipped
    populations or of a .toml file, and `estimators` may be "ideal", too. A gain, or a value of `settings` by dotted
    key, may be a list of values: all combinations are tried, at most 1000. `factors` adds rigs with one number changed;
    without `run_up` stops begin at the start speed. They brake in `jobs` processes, by default one per core: a script,
    as opposed to a notebook, must then call this below `if __name__ == "__main__":`, or with `jobs=1`. What is in the
    folder `store` stays, and the same call continues it. `progress` is called with the numbers of stops done and to do.
    Raises ConfigError, or AbsError without the extra `lab` or for stops that cannot be braked.
    """
    from inteco_abs.montecarlo import SweepFolder, work

    if jobs is not None:
        require_whole("--jobs", jobs, 1, 1024)
    names = as_list(controllers)
    if classes := [each for each in names if not isinstance(each, str)]:
        problem = f"{classes[0]!r}: other processes need a file; write it to one, and name it as file.py:Class"
        raise ConfigError.of("--controller", problem)
    lines = varied_lines(chosen_settings(settings, gains))
    file = None if config is None else Path(config)
    plan = planned_sweep(drawn(as_list(rigs), factors=factors), names, as_list(estimators), lines, file, run_up=run_up)
    path = Path(tempfile.mkdtemp(prefix="inteco-abs-sweep-") if store is None else store)
    found = Sweep(SweepFolder.make(path, plan))
    if store is None:
        weakref.finalize(found, shutil.rmtree, path, ignore_errors=True)
    where, ahead, _ = executor_of(plan, jobs)
    with redirect_stdout(sys.stderr), where:
        work(found.folder, where, ahead, progress=progress)
    if failures := found.folder.failures():
        unit, problem = next(iter(failures.items()))
        raise AbsError(f"{len(failures)} parts of the sweep were given up, first {unit}: {problem}")
    return found


def executor_of(plan: SweepPlan, jobs: int | None, executor: str | None = None) -> tuple[Executor, int, int]:
    """Where a sweep's stops brake, how many units it gets ahead, and in how many processes."""
    from inteco_abs.montecarlo import InThisProcess, LocalProcesses, cores, count_workers, named_executor

    if executor is not None:
        where: Executor = named_executor(executor)
        jobs = jobs or count_workers(where)
    else:
        jobs = min(jobs or cores(), -(-plan.count // _FEWEST_STOPS))
        where = LocalProcesses(jobs) if jobs > 1 else InThisProcess()
    return where, _AHEAD * jobs if jobs > 1 else 1, jobs


def drawn(rigs: Sequence[str], *, factors: bool) -> list[SampleSet]:
    """The ranges of draws that are named. Raises ConfigError."""
    from inteco_abs.montecarlo import one_at_a_time, parse_draws

    draws = [parse_draws(text) for text in dict.fromkeys(rigs)]
    # the names are in those of files, and some disks take Lab for lab
    if len({(one.population, one.text) for one in draws}) > len({one.population.casefold() for one in draws}):
        raise ConfigError.of("--rigs", "two different populations have the same name; rename one of the files")
    return [each for one in draws for each in one_at_a_time(one)] if factors else draws


def planned_sweep(
    draws: Sequence[SampleSet],
    controllers: Sequence[str],
    estimators: Sequence[str],
    settings: Sequence[str],
    config: Path | None,
    *,
    run_up: bool,
) -> SweepPlan:
    """All combinations of these on these rigs; settings are KEY=VALUE,VALUE. Raises ConfigError."""
    from inteco_abs.montecarlo import SweepPlan, combinations

    with redirect_stdout(sys.stderr):  # a controller's prints must not mix with the result
        known, sources = user_controllers(controllers)
    names = [f"controller.name={name}" for name in controllers] + [f"estimator.name={name}" for name in estimators]
    grid = combinations([*settings, *names], known, config)
    _require_no_rig(grid, draws)
    return SweepPlan(grid, draws, _with_files(sources, grid, known), run_up)


def _with_files(
    sources: Mapping[str, bytes], grid: Sequence[Combination], controllers: Controllers
) -> dict[str, bytes]:
    """The sources with the files that the controllers read when they are made. Raises ConfigError if one cannot be."""
    from inteco_abs.control import make_controller
    from inteco_abs.experiment import time_limit
    from inteco_abs.plugins import with_files

    with redirect_stdout(sys.stderr), time_limit():
        for one in grid:
            if one.config.controller.name in sources:
                make_controller(one.config, controllers)
    return {name: with_files(name, source) for name, source in sources.items()}


def _require_no_rig(grid: Sequence[Combination], draws: Sequence[SampleSet]) -> None:
    """Raise ConfigError if the configuration describes a rig, as --rigs does."""
    from inteco_abs.config import SimulationConfig

    mistakes = []
    if any(one.config.simulation != SimulationConfig() for one in grid):
        mistakes.append(ConfigIssue("simulation", "a sweep brakes the rigs of --rigs; leave this section out"))
    configured = {one.config.encoders.counts_per_turn for one in grid}
    rigs = [rig for each in draws if (rig := each.first_rig)]  # all of a population have the same discs
    counts = {rig.road_encoder.counts_per_turn for rig in rigs}
    if configured != counts:
        shown = ", ".join(map(str, sorted(configured - counts)))
        mistakes.append(
            ConfigIssue("encoders.counts_per_turn", f"{shown}: these rigs have {max(counts)}; leave it out")
        )
    if mistakes:
        raise ConfigError(mistakes)
