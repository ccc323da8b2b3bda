"""The report's plots that are not over time: slip over speed, and how often a tick was how late."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d, Span

from inteco_abs.views.report.plots import BLUE, GREY, RED, Drawing, Key, blank
from inteco_abs.views.report.traces import ReportTrace

_SLOWEST_RAD_S: Final = 1.0
_PUNCTUAL_US: Final = 1.0
_LEAST_SCALE_US: Final = 100.0
_LATEST_US: Final = 1e9
_BELOW_ONE_TICK: Final = 0.7
_BINS_A_DECADE: Final = 12

Array = npt.NDArray[Any]


def phase_plane(courses: Sequence[ReportTrace]) -> Drawing:
    """Slip over the road wheel's speed while braking, down to 1 rad/s; the true one too where one session knows it."""
    plot = blank("plane", "road wheel speed [rad/s]", "slip [1]")
    fastest = max(float(np.nanmax(course.points.columns["road_speed_rad_s"], initial=0.0)) for course in courses)
    plot.x_range = Range1d(0.0, max(1.05 * fastest, _SLOWEST_RAD_S))
    plot.y_range = Range1d(-0.02, 1.05)
    if len(courses) == 1:
        (course,) = courses
        legend = [Key("estimated", BLUE, "solid", "", _trace(plot, course, "slip", BLUE, "solid"))]
        if "true_slip" in course.points.columns:
            legend.append(Key("true", RED, "dashed", "", _trace(plot, course, "true_slip", RED, "dashed")))
    else:
        legend = [
            Key(look.letter, look.colour, "solid", look.sign, _trace(plot, course, "slip", look.colour, "solid"))
            for course, look in ((course, course.look) for course in courses)
        ]
    for reference in {_reference(course) for course in courses} - {None}:
        plot.add_layout(Span(location=reference, dimension="width", line_color=GREY, line_dash="dotted"))
    caption = "marker: where braking began; dotted: the reference"
    return Drawing("plane", "Slip over speed while braking", caption, plot, tuple(legend))


def _trace(plot: Any, course: ReportTrace, column: str, colour: str, dash: str) -> tuple[str, ...]:
    """Draw a line, with the session's marker where braking began; their names."""
    time_s, columns = course.points.time_s, course.points.columns
    speed, slip = columns["road_speed_rad_s"], columns[column]
    braking = (time_s >= course.held_s[0]) & (time_s <= course.held_s[1]) & (speed > _SLOWEST_RAD_S)
    speed, slip = speed[braking], slip[braking]
    names = f"plane-{course.look.letter}-{dash}", f"plane-{course.look.letter}-{dash}-start"
    plot.line(speed, slip, name=names[0], line_color=colour, line_dash=dash, line_width=1.5)
    plot.scatter(speed[:1], slip[:1], name=names[1], marker=course.look.marker, size=9, color=colour)
    return names


def _reference(course: ReportTrace) -> float | None:
    known = course.points.columns["slip_reference"]
    known = known[np.isfinite(known)]
    return float(known[0]) if len(known) else None


def timing_histogram(courses: Sequence[ReportTrace]) -> Drawing:
    """How many ticks began how late, both logarithmic; what is below 1 us counts as 1 us."""
    late = [np.clip(course.session.ticks["late_us"].astype(float), _PUNCTUAL_US, _LATEST_US) for course in courses]
    most = max(_LEAST_SCALE_US, *(float(each.max()) for each in late))
    edges = np.geomspace(_PUNCTUAL_US, most * 1.001, 1 + int(np.ceil(_BINS_A_DECADE * np.log10(most))))
    counts = [np.histogram(each, edges)[0] for each in late]
    plot = blank("lateness", "late [us]", "ticks [1]", x_axis_type="log", y_axis_type="log")
    plot.x_range = Range1d(_PUNCTUAL_US, 1.2 * most)
    plot.y_range = Range1d(_BELOW_ONE_TICK, 2.0 * max(float(each.max()) for each in counts))
    legend: list[Key] = []
    if len(courses) == 1:
        _bars(plot, edges, counts[0])
    else:
        legend = [_dots(plot, edges, found, course) for course, found in zip(courses, counts, strict=True)]
    for period_us in {_period_us(course) for course in courses} - {None}:
        plot.add_layout(Span(location=period_us, dimension="height", line_color=GREY, line_dash="dashed"))
    caption = "every tick of the session; below 1 us counts as 1 us; dashed: one period"
    return Drawing("lateness", "How many ticks began how late", caption, plot, tuple(legend))


def _bars(plot: Any, edges: Array, counts: Array) -> None:
    full = np.flatnonzero(counts)
    plot.quad(
        left=edges[full],
        right=edges[full + 1],
        bottom=_BELOW_ONE_TICK,
        top=counts[full],
        color=BLUE,
        fill_alpha=0.5,
    )


def _dots(plot: Any, edges: Array, counts: Array, course: ReportTrace) -> Key:
    look, full = course.look, np.flatnonzero(counts)
    middles = np.sqrt(edges[full] * edges[full + 1])
    names = f"lateness-{look.letter}", f"lateness-{look.letter}-marks"
    plot.line(middles, counts[full], name=names[0], line_color=look.colour, line_width=1.5)
    plot.scatter(middles, counts[full], name=names[1], marker=look.marker, size=7, color=look.colour, fill_alpha=0.35)
    return Key(look.letter, look.colour, "solid", look.sign, names)


def _period_us(course: ReportTrace) -> float | None:
    try:
        return float(course.session.metadata["controller"]["sample_time_s"]) * 1e6
    except (KeyError, ValueError):
        return None
