"""The verb `inteco-abs design`."""

from __future__ import annotations

from pathlib import Path

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


@click.command()
@run_options("config", "settings", controller="reaching-law, constant-rate, boundary-layer or predictive-reaching.")
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
    bears; an identified fade makes the brake weaker. Of predictive-reaching it certifies how far gain, dead time and
    lag of the brake may be from what the observer expects before the loop oscillates. Ends with 0 if the gains hold for
    the whole set of rigs, with 3 if there is advice.
    """
    from inteco_abs.api.design import assessed
    from inteco_abs.boards import kind_check
    from inteco_abs.config import load_config
    from inteco_abs.control import control_check, preferred_estimator
    from inteco_abs.gain_design import PREDICTED, no_figure
    from inteco_abs.views.figure import check_figure, save_figure

    known = known_controllers(options.controller)
    settings = (*options.settings, *options.chosen)
    rig = load_config(options.config, settings, [kind_check, control_check(known)], follows=preferred_estimator(known))
    check_table(table)
    if figure is not None:
        check_figure(figure)
        if rig.controller.name == PREDICTED:
            raise no_figure()
    found = assessed(rig, uncertain, speeds, slip_band, from_slip, lag, dead_time)
    report = found.report()
    if table is not None:
        curves = report["curves"]
        write_csv([dict(zip(curves, row, strict=True)) for row in zip(*curves.values(), strict=True)], table)
    if figure is not None:
        save_figure(found.plot(), figure)
    if as_json:
        print_json(report)
    else:
        show(found)
    return LOSSES if found.advice else 0
