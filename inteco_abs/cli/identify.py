"""The verb `inteco-abs identify`."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from inteco_abs.cli.dry_run import Planned, check_start, dry_run_option, refuse_start
from inteco_abs.cli.options import (
    FILE,
    LOSSES,
    Finite,
    RunOptions,
    json_option,
    known_controllers,
    require_different,
    run_options,
)
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import fit_progress, print_json, say, show
from inteco_abs.errors import ConfigError, ConfigIssue

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.gain_design import Assessment
    from inteco_abs.identification import Identification


_MOST_NAMED: Final = 12
"""Names in one line: without brake steps, a hundred points of the brake map are not identified."""


@click.command()
@click.argument("files", nargs=-1, type=FILE, metavar="[SESSION]...")
@click.option(
    "--plan",
    is_flag=True,
    help="Record the needed sessions with a board, one after another; after SESSIONs, those that would help most.",
)
@click.option(
    "-o",
    "--out",
    type=FILE,
    help="Parameter file to write (.toml), for --config of run, design and sweep; with --plan: the sessions' folder.",
)
@dry_run_option
@click.option("--pause", "pause_s", default=10.0, show_default=True, type=Finite(0, 3600, unit="s"),
              help="With --plan in real time: seconds between two runs, to cool the motors.")  # fmt: skip
@run_options(
    "config",
    "settings",
    board="With --plan: board address; sim: is the mock board.",
    virtual="With --plan: use virtual time; sim: only.",
    rig="With --plan: simulate a sampled rig, as hard:17.",
    controller="Also write this controller to --out, with the brake's lag where it inverts one, and check its gains "
    "for the intervals, as `design` does.",
    estimator="With --controller: the estimator that is written beside it.",
)
@click.option(
    "--assume",
    multiple=True,
    metavar="NAME=SHARE",
    help="Uncertainty of an assumed parameter, as J1=1%: J1, J2, Mg, d1 or M10, both ways.",
)
@click.option("--figure", type=FILE, help="Also draw the residuals: .png, .svg or .pdf.")
@json_option
def identify(
    files: tuple[Path, ...],
    plan: bool,
    out: Path | None,
    dry_run: bool,
    pause_s: float,
    options: RunOptions,
    assume: tuple[str, ...],
    figure: Path | None,
    as_json: bool,
) -> int:
    """Identify a rig's parameters from recorded sessions.

    From run-ups, coast-downs and brake steps it identifies frictions, drive motor, brake (static map, lag, dead time)
    and friction curve, each with a 95 % interval. Encoder counts give ratios only: geometry, inertias and the lever's
    moment come from the configuration's model, and their uncertainty (--assume) is part of the intervals. Ends with 3
    if something could not be identified. With --controller, the file of --out is all that `run --config` needs. With
    --plan after sessions, it records the runs that would make the intervals narrowest, and says by how much; --dry-run
    only says it.
    """
    from inteco_abs.boards import kind_check
    from inteco_abs.config import load_config
    from inteco_abs.control import control_check, preferred_estimator
    from inteco_abs.views.figure import check_figure

    _require_fitting(options, plan=plan)
    if not plan and not files:
        raise ConfigError.of("SESSION", "name at least one session, or --plan to record what is needed")
    if dry_run and not plan:
        raise ConfigError.of("--dry-run", "only with --plan; without it, nothing moves")
    assumed = _assumed(assume)
    if plan:
        return _record(options, files, assumed, out, pause_s, dry_run=dry_run, as_json=as_json)
    known = known_controllers(options.controller)
    settings = (*options.settings, *options.chosen)
    rig = load_config(options.config, settings, [kind_check, control_check(known)], follows=preferred_estimator(known))
    require_different({"--out": out, "--figure": figure})
    if out is not None:
        from inteco_abs.identification import check_parameter_file

        check_parameter_file(out)
    if figure is not None:
        check_figure(figure)
    found = _identified(rig, files, assumed)
    _report(found, out, figure, rig if options.controller else None, as_json=as_json)
    return LOSSES if found.missing or not found.fit.converged else 0


def _require_fitting(options: RunOptions, *, plan: bool) -> None:
    """The controller and the estimator are those that will use the result."""
    if plan and (options.controller or options.estimator):
        option = "--controller" if options.controller else "--estimator"
        raise ConfigError.of(option, "not with --plan, whose runs have steps of the brake; give it with the sessions")
    if options.estimator and not options.controller:
        raise ConfigError.of("--estimator", "only with --controller")
    if options.controller and ".py" in options.controller:
        problem = f"{options.controller}: a file cannot name it, as it is code; give it to `run`, beside --config"
        raise ConfigError.of("--controller", problem)


def _report(
    found: Identification, out: Path | None, figure: Path | None, law: RigConfig | None, *, as_json: bool
) -> None:
    """Write and print the result, for the controller of `law` if there is one."""
    from inteco_abs.api.identify import law_sections, with_identified
    from inteco_abs.plugins import Controllers

    law = None if law is None else with_identified(law, found, Controllers())
    if out is not None:
        found.save(out, None if law is None else law_sections(law))
    assessment = None if law is None else _judged(law, found)
    if as_json:
        print_json(found.report() | ({} if assessment is None else {"design": assessment.report()}))
    else:
        show(found)
        if assessment is not None:
            show(assessment)
    if out is not None:
        say(f"parameters: {out}; use them with --config {out}", err=True)
    if figure is not None:
        from inteco_abs.views.figure import save_figure

        save_figure(found.plot(), figure)
        say(f"figure: {figure}", err=True)
    missing: dict[str, list[str]] = {}
    for each in found.missing:
        missing.setdefault(each.why, []).append(each.name)
    for why, names in missing.items():
        others = f" and {len(names) - _MOST_NAMED} others" if len(names) > _MOST_NAMED else ""
        say(f"inteco-abs: not identified: {', '.join(names[:_MOST_NAMED])}{others}: {why}", err=True)
    if missing:
        kept = "" if law is None else "; the controller's model has the configuration's values in their place"
        say(f"inteco-abs: identify --plan with these sessions records what would help most{kept}", err=True)
    if not found.fit.converged:
        say("inteco-abs: the fit did not converge: look at the residuals (--figure)", err=True)


def _judged(law: RigConfig, found: Identification) -> Assessment | None:
    """The assessment by `design`; None, with the reason as a message, where it has none."""
    from inteco_abs.api.identify import judged

    try:
        return judged(law, found)
    except ConfigError as error:  # the fit is what was asked for, and stays
        say(f"inteco-abs: the gains were not checked: {error}", err=True)
        return None


def _identified(rig: RigConfig, files: tuple[Path, ...], assumed: dict[str, float]) -> Identification:
    from inteco_abs.api.identify import identified
    from inteco_abs.sessions import read_session

    sessions = (read_whole(file, read_session) for file in files)  # one at a time in memory
    with fit_progress() as progress:
        return identified(rig, sessions, assumed, progress, partial(say, err=True))


def _assumed(statements: tuple[str, ...]) -> dict[str, float]:
    from inteco_abs.errors import near_match
    from inteco_abs.identification import ASSUMED

    shares, issues = {}, []
    for statement in statements:
        name, _, text = (part.strip() for part in statement.partition("="))
        try:
            percent = float(text.removesuffix("%")) if text.endswith("%") else -1.0
        except ValueError:
            percent = -1.0
        if name not in ASSUMED:
            issues.append(ConfigIssue("--assume", f"{statement}: not an assumed parameter{near_match(name, ASSUMED)}"))
        elif not 0.01 <= percent <= 90.0:
            issues.append(ConfigIssue("--assume", f"{statement}: must look like {name}=5%, with 0.01 % to 90 %"))
        shares[name] = percent / 100.0
    if issues:
        raise ConfigError(issues)
    return shares


def _record(
    options: RunOptions,
    files: tuple[Path, ...],
    assumed: dict[str, float],
    out: Path | None,
    pause_s: float,
    *,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Record the plan's runs until one does not complete; return the exit code of the last one."""
    from inteco_abs.api.identify import next_planned_runs, planned_run
    from inteco_abs.control import control_check
    from inteco_abs.sessions import check_folder, check_output, ensured_directory

    folder = out or Path("identification")
    planned_here = partial(planned_run, folder=folder, board=options.board, virtual=options.virtual)
    try:
        rig = options.load(checks=[control_check()])
        runs = next_planned_runs(rig, _identified(rig, files, assumed) if files else None)
        planned = [
            Planned(*planned_here(each, options.load, seed=number), shows=each.shows)
            for number, each in enumerate(runs, len(files))
        ]
    except ConfigError as error:
        if dry_run:
            return refuse_start([partial(check_folder, folder)], error, as_json=as_json)
        raise
    if not planned:
        say("no further run would make an interval narrower by 5 %: what is assumed is left (--assume)", err=True)
        return 0
    pause_s = 0.0 if options.virtual else pause_s
    if dry_run:
        places = [partial(check_output, each.plan.out) for each in planned] if folder.is_dir() else []
        return check_start(planned, [partial(check_folder, folder), *places], pause_s=pause_s, as_json=as_json)
    with ensured_directory(folder):
        for number, each in enumerate(planned):
            if number:
                time.sleep(pause_s)
            say(f"{number + 1} of {len(planned)}: {each.shows}", err=True)
            code = _run(each)
            if code not in {0, LOSSES}:
                return code
    folders = dict.fromkeys((*(str(file.parent) for file in files), str(folder)))
    sessions = " ".join(f"{each}/*.mcap" for each in folders)
    say(f"recorded; now: inteco-abs identify {sessions} -o rig-parameters.toml", err=True)
    return 0


def _run(each: Planned) -> int:
    from inteco_abs.experiment import run_stop

    stop = run_stop(each.config, each.plan)
    if stop.exit_code:
        say(f"inteco-abs: {each.plan.out.stem}: {stop.outcome}: {stop.explanation}", err=True)
    return stop.exit_code
