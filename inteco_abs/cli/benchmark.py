"""The verb `inteco-abs benchmark`."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.completion import controller_names
from inteco_abs.cli.options import DIFFERS, FILE, Whole, json_option
from inteco_abs.cli.sweep import brake_missing
from inteco_abs.cli.terminal import print_json, say, show
from inteco_abs.errors import AbsError, ConfigError, describe_disk, near_match

if TYPE_CHECKING:
    from inteco_abs.benchmark import Law
    from inteco_abs.plugins import Controllers

_FIRST_SEED: Final = 700_000
"""Of the draws: no constant or gain was chosen on these."""
_NARROWEST: Final = 100
"""Columns of the table."""


@click.command()
@click.option(
    "-o",
    "--out",
    "folder",
    type=FILE,
    default=Path("benchmark"),
    show_default=True,
    metavar="DIR",
    help="Folder for stops, tables, figures and page; the same command continues what is there.",
)
@click.option(
    "--law",
    "chosen",
    multiple=True,
    shell_complete=controller_names,
    metavar="NAME",
    help="Only this: a name in the table, any controller, or your own as file.py:Class; may be repeated.",
)
@click.option("--laws", "file", type=FILE, help="Take the laws from this file (.toml).")
@click.option("--draws", type=Whole(1, 1_000_000), default=100, show_default=True, help="Rigs of each population.")
@click.option("--no-factors", is_flag=True, help="Leave out the rigs with one factor changed at a time.")
@click.option("--tune", "tuning", is_flag=True, help="First search the gains, with the same budget for each law.")
@click.option(
    "--against", type=FILE, metavar="FILE", help="Compare with a results.json; exit code 4 if a law is worse."
)
@click.option("--jobs", type=Whole(1, 1024), help="Number of processes; default: one per core.")
@json_option
def benchmark(
    folder: Path,
    chosen: tuple[str, ...],
    file: Path | None,
    draws: int,
    no_factors: bool,
    tuning: bool,
    against: Path | None,
    jobs: int | None,
    as_json: bool,
) -> int:
    """Compare all laws on the same simulated rigs.

    Shipped laws, and those that others published for this rig, brake the rigs of nominal, hard, rough, slow, capped and
    wild, and of hard with one factor changed at a time. They are judged by the true slip from 0.25 s after braking
    began. DIR gets the stops, the results as JSON with bootstrap intervals, a table, figures, the laws with their
    gains, and all this as a page.
    """
    from inteco_abs.api.controllers import user_controllers
    from inteco_abs.benchmark import ranges, read_laws, shipped_laws
    from inteco_abs.montecarlo import SweepFolder, SweepPlan
    from inteco_abs.views.figure import require_matplotlib

    require_matplotlib()
    kept = None if against is None else _kept(against)
    laws = shipped_laws() if file is None else read_laws(file)
    with redirect_stdout(sys.stderr):  # a controller's prints must not mix with the result
        controllers, sources = user_controllers([name for name in chosen if ".py:" in name])
        laws = _chosen(laws, chosen, controllers)
        if tuning:
            laws = _tuned(laws, controllers, sources, jobs)
        grid = [law.combination(controllers) for law in laws]
    plan = SweepPlan(grid, ranges(draws, _FIRST_SEED, factors=not no_factors), sources)
    stops = SweepFolder.make(folder / "stops", plan, "--out")
    code = brake_missing(stops, jobs, None)
    found = _results(laws, controllers, stops)
    say(f"written: {', '.join(_write(folder, laws, found))}", err=True)
    if as_json:
        print_json(found)
    else:
        from inteco_abs.benchmark.page import render_benchmark

        show(render_benchmark(found), width=_NARROWEST)
    return max(code, 0 if kept is None else _compare(found, kept))


def _kept(path: Path) -> dict[str, Any]:
    try:
        kept: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError.of("--against", f"{path}: cannot be read: {error.strerror}") from error
    except ValueError:
        kept = None
    if not isinstance(kept, dict) or kept.get("schema_version") != 1 or not isinstance(kept.get("laws"), dict):
        raise ConfigError.of("--against", f"{path}: not a results.json of `benchmark`; name the one to compare with")
    return kept


def _chosen(laws: Sequence[Law], names: Sequence[str], controllers: Controllers) -> list[Law]:
    """Those of the names; a controller that no law has is one with its default gains. Raises ConfigError."""
    from inteco_abs.benchmark import DEFAULT_ESTIMATOR, Law

    known = {law.name: law for law in laws}
    found = []
    for name in dict.fromkeys(names):
        if name in known:
            found.append(known[name])
        elif name in controllers:
            estimator = getattr(controllers[name], "estimator", DEFAULT_ESTIMATOR)
            found.append(Law(name, name, estimator))
        else:
            hint = near_match(name, [*known, *controllers])
            raise ConfigError.of(
                "--law", f"no law or controller {name!r}{hint}; the table of `benchmark` lists the laws"
            )
    return found or list(laws)


def _tuned(laws: Sequence[Law], controllers: Controllers, sources: Mapping[str, bytes], jobs: int | None) -> list[Law]:
    """Each with the best numbers of the search, but for those with fixed gains."""
    from inteco_abs.benchmark import FIXED_GAINS, Budget, tune
    from inteco_abs.montecarlo import LocalProcesses, cores

    jobs, budget, found = jobs or cores(), Budget(), []
    pool: Any = LocalProcesses(jobs) if jobs > 1 else nullcontext()
    with pool as executor:
        where: Executor | None = executor
        for law in laws:
            if law.gains_from in FIXED_GAINS:
                found.append(law)
                continue
            began = time.monotonic()
            better, cost, before = tune(law, controllers, budget, where, sources.get(law.controller, b""))
            took = f"{budget.candidates} candidates in {time.monotonic() - began:.0f} s"
            say(f"{law.name}: cost {before:.2f} -> {cost:.2f}, {took}", err=True)
            found.append(better)
    return found


def _results(laws: Sequence[Law], controllers: Controllers, stops: Any) -> dict[str, Any]:
    """All that results.json has."""
    from inteco_abs.benchmark import decision_times, results_of
    from inteco_abs.montecarlo import parse_draws
    from inteco_abs.version import __version__

    found = results_of(laws, stops.rows())
    times = decision_times(laws, parse_draws(f"hard:{_FIRST_SEED}").rigs, controllers)
    program = stops.plan.description["program"]
    result: dict[str, Any] = {"schema_version": 1, "version": __version__, "source_sha256": program["source_sha256"]}
    result["packages"], result["laws"] = stops.plan.description["packages"], {}
    for law in laws:
        time_us = times[law.name]
        result["laws"][law.name] = {
            "controller": law.controller,
            "estimator": law.estimator,
            "numbers": dict(law.numbers),
            "gains_from": law.gains_from,
            "decision_us": None if time_us is None else round(time_us, 1),
            "ranges": found[law.name],
        }
    return result


def _write(folder: Path, laws: Sequence[Law], found: Mapping[str, Any]) -> list[str]:
    """Write all files; their names."""
    from inteco_abs.benchmark import write_laws
    from inteco_abs.benchmark.page import write_page
    from inteco_abs.sessions import atomic_write

    try:
        write_laws(laws, folder / "laws.toml")
        with atomic_write(folder / "results.json") as part:
            part.write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8", newline="\n")
        pages = write_page(found, folder)
    except OSError as error:
        raise AbsError(f"{error.filename or folder}: cannot be written: {describe_disk(error)}") from error
    return [str(folder / name) for name in ("laws.toml", "results.json", *pages)]


def _compare(found: Mapping[str, Any], kept: Mapping[str, Any]) -> int:
    """Report what is worse than the kept results; the exit code."""
    from inteco_abs.benchmark import compared

    problems = list(compared(found, kept))
    for problem in problems:
        say(f"inteco-abs: {problem}", err=True)
    return DIFFERS if problems else 0
