"""The verb `inteco-abs design`."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import click

from inteco_abs.cli.completion import controller_names, key_names
from inteco_abs.cli.options import (
    FILE,
    LOSSES,
    SETTING,
    Finite,
    check_table,
    json_option,
    known_controllers,
    print_json,
)
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue, describe_disk

_SLOWEST_RAD_S: Final = 10.0
_FASTEST_RAD_S: Final = 245.0
_LEAST_SLIP: Final = 0.01
"""Below, the model has next to no adhesion, and soon a negative one."""


@click.command()
@click.option("--config", type=FILE, help="rig.toml; every key has a default.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    type=SETTING,
    shell_complete=key_names,
    metavar="KEY=VALUE",
    help="Over the file, as in controller.gains.Mq=4.",
)
@click.option("--controller", shell_complete=controller_names, help="reaching-law, constant-rate or boundary-layer.")
@click.option(
    "--uncertain",
    multiple=True,
    metavar="NAME=SPREAD",
    help="What is known only so well, as J1=5% or M10=0.002 (SI unit), both ways: a constant of the model or of the "
    "brake's line (b1, b2), mu (a factor on the adhesion), adhesion_blend (0..1, towards the measured curve), "
    "brake_gain, brake_duty_offset, or f and g as such. Without it: the population `hard`, but for the bumps of its "
    "measured brake map, for which b2=1.2 stands.",
)
@click.option(
    "--speeds",
    nargs=2,
    type=Finite(),
    metavar="LOW HIGH",
    help="Road speeds, rad/s; default: 10 to the start of braking.",
)
@click.option(
    "--slip-band",
    nargs=2,
    type=Finite(),
    metavar="LOW HIGH",
    help="Conditions of sliding for these slips, not only the reference.",
)
@click.option("--from-slip", type=Finite(), help="Also judge reaching from this slip.")
@click.option("--csv", "table", type=FILE, help="Also write all curves over the road speed: .csv.")
@click.option("--figure", type=FILE, help="Also draw them: .png, .svg or .pdf.")
@json_option
def design(
    config: Path | None,
    settings: tuple[str, ...],
    controller: str | None,
    uncertain: tuple[str, ...],
    speeds: tuple[float, float] | None,
    slip_band: tuple[float, float] | None,
    from_slip: float | None,
    table: Path | None,
    figure: Path | None,
    as_json: bool,
) -> int:
    """Judge gains for a rig that is not known exactly.

    How large Mq must be for sliding, by (25) and (26), how long reaching may take, by (20), and whether the brake can
    do it within its duty limit. For an ideal loop, without lag, delay and noise. Ends with exit code 0 when all is well
    for the whole set, with 3 when there is advice.
    """
    from inteco_abs.config import load_config
    from inteco_abs.control import control_check, preferred_estimator
    from inteco_abs.gain_design import HARD, judge_gains, stated_box
    from inteco_abs.gain_design.figure import draw_design
    from inteco_abs.rig import nominal_parameters
    from inteco_abs.views.figure import check_figure

    chosen = [f"controller.name={controller}"] if controller else []
    known = known_controllers(controller)
    check, follows = control_check(known), preferred_estimator(known)
    rig = load_config(config, [*settings, *chosen], [check], follows=follows)
    speeds = speeds or (_SLOWEST_RAD_S, max(rig.experiment.start_speed_rad_s, _SLOWEST_RAD_S + 1.0))
    slips = [0.0] if from_slip is None else [0.0, from_slip]
    _insist_on_ranges(speeds, slip_band, slips, rig.controller.reference_slip)
    check_table(table)
    if figure is not None:
        check_figure(figure)
    box = stated_box(uncertain or HARD, nominal_parameters(rig.model))
    report = judge_gains(rig, box, speeds, slip_band, slips).report()
    if table is not None:
        _write_table(report["curves"], table)
    if figure is not None:
        draw_design(report, figure)
    if as_json:
        print_json(report)
    else:
        _print_report(report)
    return LOSSES if report["advice"] else 0


def _insist_on_ranges(
    speeds: tuple[float, float], slip_band: tuple[float, float] | None, from_slips: Sequence[float], reference: float
) -> None:
    mistakes = [*_range_mistakes("--speeds", speeds, 0.1, _FASTEST_RAD_S, "rad/s")]
    if slip_band is not None:
        mistakes += _range_mistakes("--slip-band", slip_band, _LEAST_SLIP, 1.0, "of slip")
    mistakes += [
        ConfigIssue("--from-slip", f"{slip:g}: must be in 0..1") for slip in from_slips if not 0.0 <= slip <= 1.0
    ]
    if reference < _LEAST_SLIP:
        problem = (
            f"{reference:g}: must be at least {_LEAST_SLIP:g} for a design; below, the model has next to no adhesion"
        )
        mistakes.append(ConfigIssue("controller.reference_slip", problem))
    if mistakes:
        raise ConfigError(mistakes)


def _range_mistakes(
    option: str, stated: tuple[float, float], least: float, most: float, unit: str
) -> list[ConfigIssue]:
    low, high = stated
    if not (least <= low <= most and least <= high <= most):
        return [ConfigIssue(option, f"{low:g} {high:g}: must both be in {least:g}..{most:g} {unit}")]
    if not low < high:
        return [ConfigIssue(option, f"{low:g} {high:g}: must rise; write {option} {high:g} {low:g}")]
    return []


def _write_table(curves: Mapping[str, Any], path: Path) -> None:
    """One row a road speed; what has no bound is empty."""
    from inteco_abs.sessions import atomic_write

    try:
        with atomic_write(path) as part, part.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(curves)
            writer.writerows(zip(*curves.values(), strict=True))
    except OSError as error:
        raise AbsError(f"{path}: the table cannot be written: {describe_disk(error)}") from error


def _print_report(report: Mapping[str, Any]) -> None:
    from rich.console import Console

    from inteco_abs.gain_design.table import render_design

    Console().print(render_design(report))
