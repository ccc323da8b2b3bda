"""Layouts for viewers that open sessions, as each viewer saves them.

To change one, change it in the viewer and export it. Formats: Lichtblick 1.28 (panels Plot, StateTransitions and Log,
which it calls RosOut; Foxglove shares them) and PlotJuggler 3.17 (layout 2.3.8, MCAP loader, protobuf parser); see
docs/facts/sessions.md#encodings.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

_FILES: Final = {"lichtblick": "lichtblick.json", "plotjuggler": "plotjuggler.xml"}


def layout_of(viewer: str) -> bytes:
    """The layout for `lichtblick`, which Foxglove reads too, or for `plotjuggler`."""
    return Path(__file__).with_name(_FILES[viewer]).read_bytes()
