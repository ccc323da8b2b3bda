"""The verb `inteco-abs layout`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from inteco_abs.cli.options import FILE, say

_VIEWERS: Final = ("lichtblick", "plotjuggler")


@click.command()
@click.option("--for", "viewer", type=click.Choice(_VIEWERS), required=True, help="Viewer that is to open it.")
@click.option("--out", "-o", type=FILE, help="File to write; default: standard output.")
def layout(viewer: str, out: Path | None) -> int:
    """Write a layout with which a viewer shows sessions: speeds, slip, duties, switching function, timing, log.

    Lichtblick, and Foxglove: Layouts, Import from file. PlotJuggler: plotjuggler --layout FILE --datafile SESSION, and
    choose the topics /abs/tick and /sim/truth.
    """
    from inteco_abs.views.layouts import layout_of, write_layout

    if out is None:
        say(layout_of(viewer).decode(), nl=False)
    else:
        write_layout(viewer, out)
        say(str(out))
    return 0
