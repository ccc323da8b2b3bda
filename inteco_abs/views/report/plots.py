"""The report's plots over time: one below the other, with one time for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from bokeh.models import (
    ColumnDataSource,
    CrosshairTool,
    DataRange1d,
    Range1d,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure

from inteco_abs.views.figure import COLOURS
from inteco_abs.views.report.phases import draw_bands, name_bands
from inteco_abs.views.report.traces import MARGIN_S, ReportTrace

TIME_RANGE: Final = "time"
"""Name of the range that all plots over time share."""
CURSOR: Final = "cursor"
"""Name of the line that follows the mouse in all of them."""
_HEIGHT: Final = 230
_LEFT: Final = 64
"""Room for numbers and unit, the same in every plot, so that one instant is one vertical line."""
BLUE, RED, GREEN = COLOURS
GREY: Final = "#808080"
"""Readable on white and on black."""
_MARKS: Final = 12
_FEW_POINTS: Final = 20
_LINE_WIDTH: Final = 1.5
_SLOW_RAD_S: Final = 10.0
_FLATTEST_SLIP: Final = 0.4


class Line(NamedTuple):
    """A signal in a plot."""

    column: str
    name: str
    dash: str
    colour: str
    beside: bool = True
    """Whether it is drawn where there are several sessions, too."""


class Panel(NamedTuple):
    """One plot over time."""

    key: str
    title: str
    axis: str
    lines: tuple[Line, ...]


_SLIP: Final = (
    Line("slip", "estimated", "solid", BLUE),
    Line("true_slip", "true", "dashed", RED),
)
_REFERENCE: Final = Line("slip_reference", "reference", "dotted", GREY)
PANELS: Final = (
    Panel(
        "speeds",
        "Speeds",
        "speed [rad/s]",
        (
            Line("road_speed_rad_s", "road wheel (car)", "solid", RED),
            Line("wheel_speed_rad_s", "braked wheel", "dashed", BLUE),
        ),
    ),
    Panel("slip", "Slip", "slip [1]", (*_SLIP, _REFERENCE)),
    Panel(
        "torque",
        "Brake torque",
        "torque [N m]",
        (
            Line("torque_demand_nm", "asked for by the law", "solid", BLUE),
            Line("true_brake_torque_nm", "true", "dashed", RED),
        ),
    ),
    Panel(
        "duty",
        "Duty cycles",
        "duty [1]",
        (Line("brake", "brake", "solid", BLUE), Line("drive", "drive", "dashed", RED)),
    ),
    Panel(
        "switching",
        "Sliding variable",
        "switching function [1]",
        (Line("switching", "switching function", "solid", BLUE),),
    ),
    Panel(
        "timing",
        "Punctuality",
        "duration [us]",
        (
            Line("late_us", "late", "solid", BLUE),
            Line("io_us", "exchange with the board", "dashed", RED, beside=False),
            Line("busy_us", "decision and record", "dotted", GREEN, beside=False),
        ),
    ),
)


class Key(NamedTuple):
    """An entry of a legend."""

    name: str
    colour: str
    dash: str
    sign: str
    """Marker, or nothing."""
    lines: tuple[str, ...]
    """Names of what it stands for in the plot; the page tells the first one's value at the cursor."""


class Drawing(NamedTuple):
    """A plot of bokeh's, and what must be known to read it."""

    key: str
    title: str
    caption: str
    plot: Any
    legend: tuple[Key, ...]


def time_plots(courses: Sequence[ReportTrace]) -> list[Drawing]:
    """A plot for each of `PANELS`. There is at least one course."""
    begin_s = min(course.held_s[0] for course in courses) - MARGIN_S
    shared = Range1d(begin_s, max(course.held_s[1] for course in courses) + MARGIN_S, name=TIME_RANGE)
    cursor = Span(dimension="height", line_color=GREY, name=CURSOR)
    sources = [ColumnDataSource({"t": course.points.time_s, **course.points.columns}) for course in courses]
    return [_drawing(panel, courses, sources, shared, cursor) for panel in PANELS]


def _drawing(
    panel: Panel, courses: Sequence[ReportTrace], sources: Sequence[ColumnDataSource], shared: Range1d, cursor: Span
) -> Drawing:
    since = "braking began" if any(course.braked for course in courses) else "the first tick"
    plot = blank(panel.key, f"time since {since} [s]", panel.axis, shared, window_axis="x")
    plot.add_tools(CrosshairTool(overlay=cursor, dimensions="height"))
    plot.add_tools(WheelZoomTool(dimensions="width", modifiers={"shift": True}))
    plot.y_range = _y_range(panel, courses)
    if len(courses) == 1:
        draw_bands(plot, courses[0])
        if panel.key == "slip":
            name_bands(plot, courses[0])
        legend = [
            Key(line.name, line.colour, line.dash, "", _draw(plot, panel, line, courses[0], sources[0]))
            for line in panel.lines
            if line.column in courses[0].points.columns
        ]
        return Drawing(panel.key, panel.title, "", plot, tuple(legend))
    legend = []
    told = [line for line in panel.lines if line.beside]
    for course, source in zip(courses, sources, strict=True):
        lines = [line._replace(colour=course.look.colour) for line in told if line.column in course.points.columns]
        names = [name for line in lines for name in _draw(plot, panel, line, course, source)]
        names.append(_mark(plot, panel, course))
        legend.append(Key(course.look.letter, course.look.colour, "solid", course.look.sign, tuple(names)))
    caption = ", ".join(f"{line.dash}: {line.name}" for line in told) if len(told) > 1 else told[0].name
    return Drawing(panel.key, panel.title, caption, plot, tuple(legend))


def _draw(plot: Any, panel: Panel, line: Line, course: ReportTrace, source: ColumnDataSource) -> tuple[str, ...]:
    """Draw a line, and dots on it where there are so few that it could be missed; their names."""
    name = f"{panel.key}-{course.look.letter}-{line.column}"
    plot.line(
        "t",
        line.column,
        source=source,
        name=name,
        line_color=line.colour,
        line_dash=line.dash,
        line_width=_LINE_WIDTH,
    )
    if len(course.points.time_s) > _FEW_POINTS:
        return (name,)
    plot.scatter("t", line.column, source=source, name=f"{name}-dots", color=line.colour, size=5)
    return name, f"{name}-dots"


def _mark(plot: Any, panel: Panel, course: ReportTrace) -> str:
    """Put a few markers on the first line, so that colour is not the only sign of a session; their name."""
    name, points = f"{panel.key}-{course.look.letter}-marks", course.points
    rows = np.unique(np.searchsorted(points.time_s, np.linspace(*course.held_s, _MARKS)))
    rows = rows[rows < len(points.time_s)]
    plot.scatter(
        points.time_s[rows],
        points.columns[panel.lines[0].column][rows],
        name=name,
        marker=course.look.marker,
        size=8,
        color=course.look.colour,
        fill_alpha=0.35,
    )
    return name


def blank(name: str, x_axis: str, y_axis: str, x_range: Any = None, **options: Any) -> Any:
    """An empty plot that takes its colours from the page."""
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


def _y_range(panel: Panel, courses: Sequence[ReportTrace]) -> Any:
    if panel.key == "slip":
        return Range1d(-0.02, max(_highest_slip(course) for course in courses))
    return DataRange1d(only_visible=True, range_padding=0.05)


def _highest_slip(course: ReportTrace) -> float:
    """A little above the largest slip that means something: near standstill it is the encoders' trembling."""
    columns = course.points.columns
    moving = (columns["road_speed_rad_s"] > _SLOW_RAD_S) & np.isfinite(columns["slip_reference"])
    top = float(np.nanmax(columns["slip"][moving], initial=0.0)) if moving.any() else 1.0
    return float(np.clip(1.25 * top, _FLATTEST_SLIP, 1.05))
