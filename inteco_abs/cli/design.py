"""The verb `inteco-abs design`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from inteco_abs.cli.options import (
    FILE,
    LOSSES,
    Finite,
    RunOptions,
    check_table,
    json_option,
    known_controllers,
    run_options,
    write_csv,
)
from inteco_abs.cli.terminal import print_json, show
from inteco_abs.errors import ConfigError, ConfigIssue

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.gain_design import Brake

_SLOWEST_RAD_S: Final = 10.0
_FASTEST_RAD_S: Final = 245.0
_LEAST_SLIP: Final = 0.01
"""Below, the model's adhesion is near zero or negative."""


@click.command()
@run_options("config", "settings", controller="reaching-law, constant-rate or boundary-layer.")
@click.option(
    "--uncertain",
    multiple=True,
    metavar="NAME=SPREAD",
    help="Uncertainty of a parameter, as J1=5% or M10=0.002 (SI unit), both ways: a constant of the model or of the "
    "brake's line (b1, b2), mu (a factor on the adhesion), adhesion_blend (0..1, towards the measured curve), "
    "brake_gain, brake_duty_offset, or f and g themselves. Default: the population `hard`, with b2=1.2 instead of the "
    "bumps of its measured brake map.",
)
@click.option(
    "--speeds",
    nargs=2,
    type=Finite(),
    metavar="LOW HIGH",
    help="Road speeds, rad/s; default: 10 to the start speed of braking.",
)
@click.option(
    "--slip-band",
    nargs=2,
    type=Finite(),
    metavar="LOW HIGH",
    help="Check sliding over these slips, not only at the reference.",
)
@click.option("--from-slip", type=Finite(), help="Also check reaching from this slip.")
@click.option(
    "--lag",
    nargs=2,
    type=Finite(0.0, 1.0, unit="s"),
    metavar="LOW HIGH",
    help="Also check the loop with brakes of these lags (s), the estimator's delay and sampling; default: the "
    "identified brake, if there is one.",
)
@click.option(
    "--dead-time",
    type=Finite(0.0, 1.0, unit="s"),
    help="With --lag or an identified one: the longest dead time of the brake (s).",
)
@click.option("--csv", "table", type=FILE, help="Also write all curves over the road speed (.csv).")
@click.option("--figure", type=FILE, help="Also draw the curves: .png, .svg or .pdf.")
@json_option
def design(
    options: RunOptions,
    uncertain: tuple[str, ...],
    speeds: tuple[float, float] | None,
    slip_band: tuple[float, float] | None,
    from_slip: float | None,
    lag: tuple[float, float] | None,
    dead_time: float | None,
    table: Path | None,
    figure: Path | None,
    as_json: bool,
) -> int:
    """Check gains for a rig that is not known exactly.

    It computes how large Mq must be for sliding, by (25) and (26), how long reaching may take, by (20), and whether the
    brake is strong enough within its duty limit, for an ideal loop without lag, delay and noise. With --lag, or the
    brake of a parameter file of `identify`, it also finds limit cycles of the real loop, and how much further delay it
    bears; an identified fade makes the brake weaker. Ends with 0 if the gains hold for the whole set of rigs, with 3 if
    there is advice.
    """
    from inteco_abs.boards import kind_check
    from inteco_abs.config import load_config
    from inteco_abs.control import control_check, preferred_estimator
    from inteco_abs.gain_design import HARD, faded_share, judge_gains, stated_box
    from inteco_abs.gain_design.figure import draw_design
    from inteco_abs.rig import nominal_parameters
    from inteco_abs.views.figure import check_figure

    known = known_controllers(options.controller)
    settings = (*options.settings, *options.chosen)
    rig = load_config(options.config, settings, [kind_check, control_check(known)], follows=preferred_estimator(known))
    speeds = speeds or (_SLOWEST_RAD_S, max(rig.experiment.start_speed_rad_s, _SLOWEST_RAD_S + 1.0))
    slips = [0.0] if from_slip is None else [0.0, from_slip]
    if rig.controller.constant_slip is None:
        problem = "a design judges one slip: leave it out, and give controller.reference_slip"
        raise ConfigError.of(f"controller.{rig.controller.reference_key}", problem)
    _require_ranges(speeds, slip_band, slips, rig.controller.reference_slip)
    brake = _brake(rig, lag, dead_time)
    check_table(table)
    if figure is not None:
        check_figure(figure)
    box = stated_box(uncertain or HARD, nominal_parameters(rig.model))
    if share := faded_share(rig):
        box = box.faded(share)
    report = judge_gains(rig, box, speeds, slip_band, slips, brake).report()
    if table is not None:
        curves = report["curves"]
        write_csv([dict(zip(curves, row, strict=True)) for row in zip(*curves.values(), strict=True)], table)
    if figure is not None:
        draw_design(report, figure)
    if as_json:
        print_json(report)
    else:
        from inteco_abs.gain_design.table import render_design

        show(render_design(report))
    return LOSSES if report["advice"] else 0


def _brake(rig: RigConfig, lag: tuple[float, float] | None, dead_time: float | None) -> Brake | None:
    """The brake that is stated, else the identified one."""
    from inteco_abs.gain_design import Brake, identified_brake

    if lag is not None and lag[0] > lag[1]:
        raise ConfigError.of("--lag", f"{lag[0]:g} {lag[1]:g}: must not fall; write --lag {lag[1]:g} {lag[0]:g}")
    found = identified_brake(rig) if lag is None else Brake(*lag, 0.0)
    if dead_time is None:
        return found
    if found is None:
        problem = "needs --lag LOW HIGH, or an identified lag; --lag 0 0 is a brake without lag"
        raise ConfigError.of("--dead-time", problem)
    return found._replace(dead_time_s=dead_time)


def _require_ranges(
    speeds: tuple[float, float], slip_band: tuple[float, float] | None, from_slips: Sequence[float], reference: float
) -> None:
    mistakes = [*_range_issues("--speeds", speeds, 0.1, _FASTEST_RAD_S, "rad/s")]
    if slip_band is not None:
        mistakes += _range_issues("--slip-band", slip_band, _LEAST_SLIP, 1.0, "of slip")
    mistakes += [
        ConfigIssue("--from-slip", f"{slip:g}: must be in 0..1") for slip in from_slips if not 0.0 <= slip <= 1.0
    ]
    if reference < _LEAST_SLIP:
        problem = (
            f"{reference:g}: must be at least {_LEAST_SLIP:g} for a design; below, the model has almost no adhesion"
        )
        mistakes.append(ConfigIssue("controller.reference_slip", problem))
    if mistakes:
        raise ConfigError(mistakes)


def _range_issues(option: str, stated: tuple[float, float], least: float, most: float, unit: str) -> list[ConfigIssue]:
    low, high = stated
    if not (least <= low <= most and least <= high <= most):
        return [ConfigIssue(option, f"{low:g} {high:g}: must both be in {least:g}..{most:g} {unit}")]
    if not low < high:
        return [ConfigIssue(option, f"{low:g} {high:g}: must rise; write {option} {high:g} {low:g}")]
    return []
