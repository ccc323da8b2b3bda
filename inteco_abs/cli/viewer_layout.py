"""The verb `inteco-abs viewer-layout`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from inteco_abs.cli.options import FILE
from inteco_abs.cli.terminal import say

_VIEWERS: Final = ("lichtblick", "plotjuggler")


@click.command("viewer-layout")
@click.option(
    "--for", "viewer", type=click.Choice(_VIEWERS), required=True, help="Viewer; lichtblick is also for Foxglove."
)
@click.option("--out", "-o", type=FILE, help="File to write; default: standard output.")
def viewer_layout(viewer: str, out: Path | None) -> int:
    """Write a layout for Lichtblick, Foxglove or PlotJuggler.

    It shows speeds, slip, duties, switching function, timing and log. Lichtblick and Foxglove: Layouts, Import from
    file. PlotJuggler: plotjuggler --layout FILE --datafile SESSION, then choose the topics /abs/tick and /sim/truth.
    """
    from inteco_abs.sessions import write_file
    from inteco_abs.views.layouts import layout_of

    if out is None:
        say(layout_of(viewer).decode(), nl=False)
    else:
        write_file(out, layout_of(viewer))
        say(str(out))
    return 0
