"""What an identification leaves unexplained, trace by trace, in counts."""

from __future__ import annotations

from pathlib import Path

from inteco_abs.lab.identify import Identification
from inteco_abs.views.figure import COLOURS, check_figure, save_figure

_COLUMNS = 3


def draw_residuals(found: Identification, path: Path) -> None:
    """Draw measured minus simulated counts of each segment to `path` (.png, .svg or .pdf).

    Raises ConfigError for a path that cannot be drawn to, AbsError without matplotlib.
    """
    check_figure(path)
    from matplotlib.figure import Figure  # noqa: PLC0415  heavy, and an extra

    segments = list({id(channel.segment): channel.segment for channel, _ in found.fit.left}.values())
    rows = -(-len(segments) // _COLUMNS)
    figure = Figure(figsize=(3.4 * _COLUMNS, 2.1 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, _COLUMNS, squeeze=False).flat
    for panel, segment in zip(panels, segments, strict=False):
        time_s = segment.time_s[segment.compared]
        for channel, left in found.fit.left:
            if channel.segment is segment:
                colour = COLOURS[0] if channel.wheel == "wheel" else COLOURS[1]
                panel.plot(time_s, left, color=colour, lw=0.6, label=channel.wheel)
        panel.set_title(f"{segment.session}, {segment.kind}", fontsize="small")
        panel.grid(alpha=0.3)
    for panel in list(panels)[len(segments) :]:
        panel.set_visible(False)
    first = figure.axes[0]
    first.set_ylabel("measured - simulated [counts]")
    first.set_xlabel("time in the segment [s]")
    handles = {
        label: handle for axes in figure.axes for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles, loc="outside upper right", ncols=2, frameon=False, fontsize="small")
    save_figure(figure, path)
