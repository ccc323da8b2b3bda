"""The verb `inteco-abs figure`."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import FILE, LOSSES, SESSION
from inteco_abs.cli.session_files import draw


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=SESSION)
@click.option("--out", "-o", type=FILE, required=True, help="Figure to write: .png, .svg or .pdf.")
@click.option(
    "--width",
    type=click.Choice(("one", "two")),
    default="two",
    show_default=True,
    help="Width in columns of a journal page: 88 mm or 180 mm.",
)
def figure(files: tuple[Path, ...], out: Path, width: str) -> int:
    """Draw stops for a paper: speeds, slip, brake torque.

    Several sessions are drawn over one another, and a legend names what differs. The same sessions give the same
    file.
    """
    from inteco_abs.views.figure import check_figure

    check_figure(out, "--out")
    return 0 if draw(files, out, width) else LOSSES
