"""Figure of the residuals of an identification, in counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.views.figure import COLOURS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLUMNS: Final = 3
_OF_WHEEL: Final = {"wheel": COLOURS[0], "road": COLOURS[1]}


def figure_of_residuals(traces: Sequence[Mapping[str, Any]]) -> Figure:
    """Measured minus simulated counts, a panel for each segment. Raises AbsError without matplotlib."""
    segments = list(dict.fromkeys(trace["segment"] for trace in traces))
    rows = -(-len(segments) // _COLUMNS)
    figure = new_figure(3.4 * _COLUMNS, 2.1 * rows + 0.6)
    panels = list(figure.subplots(rows, _COLUMNS, squeeze=False).flat)
    by_segment = dict(zip(segments, panels, strict=False))
    lines = {}
    for trace in traces:
        wheel, panel = trace["wheel"], by_segment[trace["segment"]]
        (lines[wheel],) = panel.plot(trace["time_s"], trace["residual_counts"], color=_OF_WHEEL[wheel], lw=0.6)
        panel.set_title(trace["segment"], fontsize="small")
        panel.grid(alpha=0.3)
    for panel in panels[len(segments) :]:
        panel.set_visible(False)
    figure.supylabel("measured - simulated [counts]", fontsize="medium")
    figure.supxlabel("time in the segment [s]", fontsize="medium")
    figure.legend(list(lines.values()), list(lines), loc="outside upper right", ncols=2, frameon=False)
    return figure
