"""The verb `inteco-abs figure`."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import FILE, LOSSES, SESSION, Finite
from inteco_abs.cli.session_files import draw
from inteco_abs.views.figure_options import LARGEST_PT, PANELS, SMALLEST_PT, STYLES, WIDTHS, FigureOptions


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=SESSION)
@click.option("--out", "-o", type=FILE, required=True, help="Figure to write: .png, .svg, .pdf or .pgf.")
@click.option(
    "--style",
    type=click.Choice(tuple(STYLES)),
    default="plain",
    show_default=True,
    help="Column widths and fonts of a journal, without a title.",
)
@click.option(
    "--width", type=click.Choice(WIDTHS), default="two", show_default=True, help="Width in columns of a journal page."
)
@click.option("--font", help="serif (as Times), sans (as Arial), or an installed font; default: the style's.")
@click.option(
    "--font-size", type=Finite(SMALLEST_PT, LARGEST_PT, unit="pt"), metavar="PT", help="Default: the style's."
)
@click.option("--title/--no-title", default=None, help="Name controller and estimator; default: as the style has it.")
@click.option("--panels", default=",".join(PANELS), show_default=True, help="Panels to draw.")
@click.option(
    "--range",
    "range_s",
    type=(float, float),
    metavar="FROM TO",
    help="Seconds since braking began; default: all from 0.2 s before.",
)
@click.option(
    "--envelope/--no-envelope", default=True, show_default=True, help="Draw torque that chatters as range and mean."
)
def figure(
    files: tuple[Path, ...],
    out: Path,
    style: str,
    width: str,
    font: str | None,
    font_size: float | None,
    title: bool | None,
    panels: str,
    range_s: tuple[float, float] | None,
    envelope: bool,
) -> int:
    """Draw stops for a paper: speeds, slip, brake torque.

    Several sessions are drawn over one another, and a legend names what differs. The same sessions give the same
    file. A .pgf is for LaTeX: it takes the document's fonts.
    """
    from inteco_abs.views.figure import check_figure

    options = FigureOptions(
        width=width, style=style, font=font, font_size_pt=font_size, title=title,
        panels=[panel.strip() for panel in panels.split(",")], range_s=range_s, envelope=envelope,
    )  # fmt: skip
    check_figure(out, "--out")
    return 0 if draw(files, out, options) else LOSSES
