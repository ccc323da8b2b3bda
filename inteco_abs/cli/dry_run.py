"""The option `--dry-run`: everything that a run does before its first write, and everything that it would refuse."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import redirect_stdout
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from inteco_abs.cli.terminal import print_json, show
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue, refusals

if TYPE_CHECKING:
    from inteco_abs.commissioning import Preflight, RigAccess
    from inteco_abs.config import RigConfig
    from inteco_abs.experiment import Plan
    from inteco_abs.mock_board import Fault

Condition = Callable[[], object]
"""Raises AbsError unless it holds."""
_MCAP_BYTES: Final = 31
"""Around each record of a session, before compression (docs/facts/sessions.md#size-of-a-record)."""


class Planned(NamedTuple):
    """One run, and how many times to do it."""

    config: RigConfig
    plan: Plan
    times: int = 1
    shows: str = ""
    """Its purpose, in a plan of several."""


def dry_run_option(function: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--dry-run",
        is_flag=True,
        help="Only read the board, and print the plan and everything that would be refused. Ends with 0 if it would "
        "begin, 2 for wrong usage or configuration, else 1.",
    )(function)


def check_start(planned: Sequence[Planned], own: Iterable[Condition], *, pause_s: float = 0.0, as_json: bool) -> int:
    """Print what these runs would do and what they would refuse; `own` are the verb's own conditions.

    Nothing is written to the board or to a disk. Exit code 0 if the first run would begin, 2 for wrong usage or
    configuration, 1 for everything else.
    """
    from inteco_abs.commissioning import run_preflight
    from inteco_abs.commissioning.preflight_table import render_preflight

    config, plan = planned[0][:2]
    refused = refusals([*own, *_conditions(planned)])
    found = run_preflight(_rig_access(config, plan.board, plan.seed), config)
    refused += found.refused
    report = {
        "schema_version": 1,
        "would_begin": not refused,
        "refused": _refusals(refused),
        "cautions": [*found.cautions, *_cautions(planned)],
        **_report(planned, found, pause_s),
    }
    if as_json:
        print_json(report)
    else:
        show(render_preflight(report))
    return _exit_code(refused)


def check_manual_start(config: RigConfig, board: str, faults: Sequence[Fault], own: Iterable[Condition]) -> int:
    """Print whether the panel could begin, as `check_start` does for runs."""
    from inteco_abs.commissioning import run_preflight
    from inteco_abs.commissioning.preflight_table import render_preflight
    from inteco_abs.experiment import manual_checks

    refused = refusals([*own, *manual_checks(config, board, faults)])
    found = run_preflight(_rig_access(config, board), config, rest=False)
    refused += found.refused
    report = {
        "refused": _refusals(refused),
        "cautions": found.cautions,
        "board": _board(board, found),
        "runs": [],
        "guard": asdict(config.guard),
        "needs": [],
        "computer": _computer(Path()),
    }
    show(render_preflight(report))
    return _exit_code(refused)


def refuse_start(own: Iterable[Condition], error: ConfigError, *, as_json: bool) -> int:
    """Print the issues of a wrong configuration together with those of the verb's `own` conditions; return 2.

    Raises them as one ConfigError without `as_json`.
    """
    others = [one for one in refusals(own) if isinstance(one, ConfigError)]
    joined = ConfigError(list(dict.fromkeys(mistake for each in (*others, error) for mistake in each.mistakes)))
    if not as_json:
        raise joined from error
    print_json({"schema_version": 1, "would_begin": False, "refused": _refusals([joined])})
    return joined.exit_code


def _exit_code(refused: Iterable[AbsError]) -> int:
    return max((2 if isinstance(error, ConfigError) else 1 for error in refused), default=0)


def _conditions(planned: Sequence[Planned]) -> Iterator[Condition]:
    from inteco_abs.experiment import run_checks
    from inteco_abs.realtime import require_room

    for config, plan, *_ in planned:
        yield from run_checks(config, plan)
        yield partial(_build, config, plan)
        if not plan.virtual:
            yield partial(require_room, _memory_bytes(config, plan))


def _build(config: RigConfig, plan: Plan) -> None:
    from inteco_abs.control import build_pipeline, check_changes, gains_to_change
    from inteco_abs.experiment import time_limit

    with redirect_stdout(sys.stderr), time_limit():  # a user's controller may print, and the report is on stdout
        pipeline = build_pipeline(config, plan.controllers)
    check_changes(config, gains_to_change(pipeline, config, plan.controllers))


def _memory_bytes(config: RigConfig, plan: Plan) -> int:
    """Shared memory of a run in real time; in virtual time, memory of this process for the whole run."""
    from inteco_abs.experiment import ring_ticks
    from inteco_abs.realtime import run_bytes
    from inteco_abs.sessions import TICK, TRUTH

    if plan.virtual:
        return _ticks(config) * (TICK.size + TRUTH.size)
    return run_bytes(TICK.size, ring_ticks(config), TRUTH.size, ring_ticks(config))


def _ticks(config: RigConfig) -> int:
    return round(config.experiment.longest_s * config.loop.rate_hz)


def _disk_bytes(config: RigConfig, plan: Plan) -> int:
    """Upper bound of a session's size, without compression."""
    from inteco_abs.boards import simulated
    from inteco_abs.sessions import TICK, TRUTH

    records = (TICK.size, TRUTH.size) if simulated(plan.board) else (TICK.size,)
    return _ticks(config) * sum(size + _MCAP_BYTES for size in records)


def _rig_access(config: RigConfig, board: str, seed: int = 0) -> RigAccess:
    from inteco_abs.boards import simulated
    from inteco_abs.commissioning import MockRigAccess, RealRigAccess
    from inteco_abs.experiment import manual_control

    return MockRigAccess(config, seed) if simulated(board) else RealRigAccess(board, manual_control)


def _refusals(refused: Iterable[AbsError]) -> list[dict[str, str]]:
    """One entry per issue, each once: several runs may share one."""
    found = []
    for error in refused:
        mistakes = error.mistakes if isinstance(error, ConfigError) else [ConfigIssue("", str(error))]
        kind = type(error).__name__
        found += [
            {"error": kind, "where": each.path, "place": each.place, "problem": each.problem} for each in mistakes
        ]
    return [one for number, one in enumerate(found) if one not in found[:number]]


def _cautions(planned: Sequence[Planned]) -> Iterator[str]:
    """Warnings that do not keep a run from beginning."""
    from inteco_abs.commissioning.preflight_table import size

    config, plan = planned[0][:2]
    if config.experiment.drive_duty > config.guard.drive_limit:
        yield (
            f"experiment.drive_duty = {config.experiment.drive_duty:g} exceeds guard.drive_limit, which cuts it to "
            f"{config.guard.drive_limit:g}"
        )
    if plan.faults:
        yield f"checked without faults; the run injects {', '.join(map(str, plan.faults))}"
    disk = _disk(planned)
    if disk["free_bytes"] < disk["bytes"]:
        yield (
            f"{disk['where']} has {size(disk['free_bytes'])} free, and the run may need {size(disk['bytes'])}: ticks "
            "that do not fit stay in memory and must be recovered from there"
        )
    if not plan.virtual:
        yield "not tried, as it needs writing: whether the board accepts its PWM settings, and the guardian's drill"


def _disk(planned: Sequence[Planned]) -> dict[str, Any]:
    import shutil

    from inteco_abs.sessions import nearest_folder

    folder = nearest_folder(planned[0].plan.out.parent)
    needed = sum(each.times * _disk_bytes(each.config, each.plan) for each in planned)
    return {"what": "disk", "where": str(folder), "bytes": needed, "free_bytes": shutil.disk_usage(folder).free}


def _memory(planned: Sequence[Planned]) -> dict[str, Any]:
    import shutil

    from inteco_abs.realtime import FOLDER

    needed = max(_memory_bytes(each.config, each.plan) for each in planned)
    if planned[0].plan.virtual or not FOLDER.is_dir():
        return {"what": "memory", "where": "this process", "bytes": needed, "free_bytes": None}
    free = shutil.disk_usage(FOLDER).free
    return {"what": "shared memory", "where": str(FOLDER), "bytes": needed, "free_bytes": free}


def _report(planned: Sequence[Planned], found: Preflight, pause_s: float) -> dict[str, Any]:
    """The plan and its resources."""
    config, plan = planned[0][:2]
    guard, runs = config.guard, sum(each.times for each in planned)
    driven_s = sum(each.times * each.config.experiment.longest_s for each in planned)
    return {
        "board": _board(plan.board, found),
        "virtual": plan.virtual,
        "runs": [_run(each) for each in planned],
        "pause_s": pause_s,
        "longest_s": driven_s + (runs - 1) * pause_s,
        "guard": asdict(guard),
        "needs": [_disk(planned), _memory(planned)],
        "computer": None if plan.virtual else _computer(plan.out.absolute().parent),
    }


def _board(board: str, found: Preflight) -> dict[str, Any]:
    identity = found.identity
    return {
        "address": board,
        "identity": None if identity is None else identity.facts(),
        "says": None if identity is None else str(identity),
        "outputs_allowed": identity is not None and not identity.read_only_because,
        "first_write": [one._asdict() for one in found.first_write],
        "moved_counts": found.moved,
        "read_us": None if found.read_us is None else found.read_us._asdict(),
    }


def _run(each: Planned) -> dict[str, Any]:
    from inteco_abs.commissioning import planned_phases

    config = each.config
    return {
        "session": str(each.plan.out),
        "shows": each.shows,
        "times": each.times,
        "stops": config.experiment.stops,
        "controller": config.controller.name,
        "estimator": config.estimator.name,
        "rate_hz": config.loop.rate_hz,
        "drive": min(config.experiment.drive_duty, config.guard.drive_limit),
        "start_speed_rad_s": config.experiment.start_speed_rad_s,
        "phases": [part._asdict() for part in planned_phases(config)],
        "longest_s": config.experiment.longest_s,
        "most_ticks": _ticks(config),
    }


def _computer(folder: Path) -> dict[str, Any]:
    """Counts of the doctor's quick findings, and the red ones."""
    from inteco_abs.host import Rating, worst
    from inteco_abs.host.doctor import examine

    findings = examine(folder)
    return {
        "verdict": worst(findings),
        **{verdict.value: sum(one.verdict is verdict for one in findings) for verdict in Rating},
        "not_fit": [one._asdict() for one in findings if one.verdict is Rating.RED],
    }
