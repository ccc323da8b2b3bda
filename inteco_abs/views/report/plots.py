"""The report's plots over time, one below the other with a common time range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from bokeh.models import ColumnDataSource, CrosshairTool, DataRange1d, Range1d, Span, WheelZoomTool
from bokeh.plotting import figure

from inteco_abs.views.figure import COLOURS
from inteco_abs.views.report.phases import draw_bands, name_bands
from inteco_abs.views.report.traces import MARGIN_S, ReportTrace

TIME_RANGE: Final = "time"
"""Name of the common time range."""
CURSOR: Final = "cursor"
"""Name of the line that follows the mouse in all plots."""
_HEIGHT: Final = 230
_LEFT: Final = 64
"""Left border, the same in every plot, so that one instant is one vertical line."""
BLUE, RED, GREEN = COLOURS
GREY: Final = "#808080"
"""Readable on white and on black."""
_MARKS: Final = 12
_FEW_POINTS: Final = 20
_LINE_WIDTH: Final = 1.5
_SLOW_RAD_S: Final = 10.0
_FLATTEST_SLIP: Final = 0.4


class PlotLine(NamedTuple):
    """A signal in a plot."""

    column: str
    name: str
    dash: str
    colour: str
    compared: bool = True
    """Whether it is also drawn for several sessions."""


class PlotPanel(NamedTuple):
    """One plot over time."""

    key: str
    title: str
    axis: str
    lines: tuple[PlotLine, ...]


PANELS: Final = (
    PlotPanel("speeds", "Speeds", "speed [rad/s]", (
        PlotLine("road_speed_rad_s", "road wheel (car)", "solid", RED),
        PlotLine("wheel_speed_rad_s", "braked wheel", "dashed", BLUE),
    )),
    PlotPanel("slip", "Slip", "slip", (
        PlotLine("slip", "estimated", "solid", BLUE),
        PlotLine("true_slip", "true", "dashed", RED),
        PlotLine("slip_reference", "reference", "dotted", GREY),
    )),
    PlotPanel("torque", "Brake torque", "torque [N m]", (
        PlotLine("torque_demand_nm", "demanded by the law", "solid", BLUE),
        PlotLine("true_brake_torque_nm", "true", "dashed", RED),
    )),
    PlotPanel("duty", "Duty cycles", "duty", (
        PlotLine("brake", "brake", "solid", BLUE),
        PlotLine("drive", "drive", "dashed", RED),
    )),
    PlotPanel("switching", "Sliding variable", "switching function", (
        PlotLine("switching", "switching function", "solid", BLUE),
    )),
    PlotPanel("timing", "Punctuality", "duration [us]", (
        PlotLine("late_us", "late", "solid", BLUE),
        PlotLine("io_us", "exchange with the board", "dashed", RED, compared=False),
        PlotLine("busy_us", "decision and record", "dotted", GREEN, compared=False),
    )),
)  # fmt: skip


class LegendEntry(NamedTuple):
    """An entry of a legend."""

    name: str
    colour: str
    dash: str
    sign: str
    """Marker, or nothing."""
    lines: tuple[str, ...]
    """Names of its renderers in the plot; the page shows the first one's value at the cursor."""


class Drawing(NamedTuple):
    """A bokeh plot with title, caption and legend."""

    key: str
    title: str
    caption: str
    plot: Any
    legend: tuple[LegendEntry, ...]


def time_plots(traces: Sequence[ReportTrace]) -> list[Drawing]:
    """A plot for each of `PANELS`, of at least one trace."""
    begin_s = min(trace.held_s[0] for trace in traces) - MARGIN_S
    shared = Range1d(begin_s, max(trace.held_s[1] for trace in traces) + MARGIN_S, name=TIME_RANGE)
    cursor = Span(dimension="height", line_color=GREY, name=CURSOR)
    sources = [ColumnDataSource({"t": trace.points.time_s, **trace.points.columns}) for trace in traces]
    return [_drawing(panel, traces, sources, shared, cursor) for panel in PANELS]


def _drawing(
    panel: PlotPanel, traces: Sequence[ReportTrace], sources: Sequence[ColumnDataSource], shared: Range1d, cursor: Span
) -> Drawing:
    since = "braking began" if any(trace.braked for trace in traces) else "the first tick"
    plot = blank(panel.key, f"time since {since} [s]", panel.axis, shared, window_axis="x")
    plot.add_tools(CrosshairTool(overlay=cursor, dimensions="height"))
    plot.add_tools(WheelZoomTool(dimensions="width", modifiers={"shift": True}))
    plot.y_range = DataRange1d(only_visible=True, range_padding=0.05)
    if panel.key == "slip":
        plot.y_range = Range1d(-0.02, max(map(_highest_slip, traces)))
    changing = [trace for trace in traces if trace.changes_s]
    for trace in changing:
        colour = trace.look.colour if len(traces) > 1 else GREY
        plot.vspan(x=list(trace.changes_s), name="change", line_color=colour, line_dash="dotdash")
    changed = "dash-dotted: a gain changed" if changing else ""
    if len(traces) == 1:
        draw_bands(plot, traces[0])
        if panel.key == "slip":
            name_bands(plot, traces[0])
        legend = [
            LegendEntry(line.name, line.colour, line.dash, "", _draw(plot, panel, line, traces[0], sources[0]))
            for line in panel.lines
            if line.column in traces[0].points.columns
        ]
        return Drawing(panel.key, panel.title, changed, plot, tuple(legend))
    legend = []
    compared = [line for line in panel.lines if line.compared]
    for trace, source in zip(traces, sources, strict=True):
        lines = [line._replace(colour=trace.look.colour) for line in compared if line.column in trace.points.columns]
        names = [name for line in lines for name in _draw(plot, panel, line, trace, source)]
        names.append(_mark(plot, panel, trace))
        legend.append(LegendEntry(trace.look.letter, trace.look.colour, "solid", trace.look.sign, tuple(names)))
    names_by_dash = ", ".join(f"{line.dash}: {line.name}" for line in compared)
    caption = names_by_dash if len(compared) > 1 else compared[0].name
    return Drawing(panel.key, panel.title, ", ".join(filter(None, (caption, changed))), plot, tuple(legend))


def _draw(plot: Any, panel: PlotPanel, line: PlotLine, trace: ReportTrace, source: ColumnDataSource) -> tuple[str, ...]:
    """Draw a line, with dots if it has few points; return their names."""
    name = f"{panel.key}-{trace.look.letter}-{line.column}"
    plot.line(
        "t", line.column, source=source, name=name, line_color=line.colour, line_dash=line.dash, line_width=_LINE_WIDTH
    )
    if len(trace.points.time_s) > _FEW_POINTS:
        return (name,)
    plot.scatter("t", line.column, source=source, name=f"{name}-dots", color=line.colour, size=5)
    return name, f"{name}-dots"


def _mark(plot: Any, panel: PlotPanel, trace: ReportTrace) -> str:
    """Put markers on the first line, so that a session is known not by colour only; return their name."""
    name, points = f"{panel.key}-{trace.look.letter}-marks", trace.points
    rows = np.unique(np.searchsorted(points.time_s, np.linspace(*trace.held_s, _MARKS)))
    rows = rows[rows < len(points.time_s)]
    plot.scatter(
        points.time_s[rows],
        points.columns[panel.lines[0].column][rows],
        name=name,
        marker=trace.look.marker,
        size=8,
        color=trace.look.colour,
        fill_alpha=0.35,
    )
    return name


def blank(name: str, x_axis: str, y_axis: str, x_range: Any = None, **options: Any) -> Any:
    """An empty plot with the page's colours."""
    plot = figure(
        name=name,
        height=_HEIGHT,
        min_border_left=_LEFT,
        sizing_mode="stretch_width",
        tools="xpan,xbox_zoom,box_zoom,undo,reset,save",
        active_drag="xbox_zoom" if x_range is not None else "box_zoom",
        toolbar_location="right",
        x_axis_label=x_axis,
        y_axis_label=y_axis,
        background_fill_color=None,
        border_fill_color=None,
        **({} if x_range is None else {"x_range": x_range}),
        **options,
    )
    plot.toolbar.logo = None
    plot.axis.axis_label_text_font_style = "normal"
    return plot


def _highest_slip(trace: ReportTrace) -> float:
    """A quarter above the largest slip, without the encoder noise near standstill."""
    columns = trace.points.columns
    moving = (columns["road_speed_rad_s"] > _SLOW_RAD_S) & np.isfinite(columns["slip_reference"])
    top = float(np.nanmax(columns["slip"][moving], initial=0.0)) if moving.any() else 1.0
    return float(np.clip(1.25 * top, _FLATTEST_SLIP, 1.05))
