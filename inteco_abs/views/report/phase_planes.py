"""The report's plots that are not over time: slip over speed, and a histogram of lateness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from bokeh.models import Range1d, Span

from inteco_abs.sessions import Array
from inteco_abs.views.report.plots import BLUE, GREY, RED, Drawing, LegendEntry, blank
from inteco_abs.views.report.traces import ReportTrace

_SLOWEST_RAD_S: Final = 1.0
_PUNCTUAL_US: Final = 1.0
_LEAST_SCALE_US: Final = 100.0
_LATEST_US: Final = 1e9
_BELOW_ONE_TICK: Final = 0.7
_BINS_A_DECADE: Final = 12
_BLOCK_TICKS: Final = 1 << 16


def phase_plane(traces: Sequence[ReportTrace]) -> Drawing:
    """Slip over road speed while braking, down to 1 rad/s; for one simulated session also the true slip."""
    plot = blank("plane", "road wheel speed [rad/s]", "slip")
    fastest = max(float(np.nanmax(trace.points.columns["road_speed_rad_s"], initial=0.0)) for trace in traces)
    plot.x_range = Range1d(0.0, max(1.05 * fastest, _SLOWEST_RAD_S))
    plot.y_range = Range1d(-0.02, 1.05)
    if len(traces) == 1:
        (trace,) = traces
        legend = [LegendEntry("estimated", BLUE, "solid", "", _line(plot, trace, "slip", BLUE, "solid"))]
        if "true_slip" in trace.points.columns:
            legend.append(LegendEntry("true", RED, "dashed", "", _line(plot, trace, "true_slip", RED, "dashed")))
    else:
        legend = [
            LegendEntry(look.letter, look.colour, "solid", look.sign, _line(plot, trace, "slip", look.colour, "solid"))
            for trace, look in ((trace, trace.look) for trace in traces)
        ]
    constant = set()
    for trace in traces:
        references = trace.points.columns["slip_reference"]
        known = np.isfinite(references)
        if len(found := np.unique(references[known])) == 1:
            constant.add(float(found[0]))
        elif len(found):
            speed, dotted = trace.points.columns["road_speed_rad_s"][known], {"line_color": GREY, "line_dash": "dotted"}
            plot.line(speed, references[known], name=f"plane-{trace.look.letter}-reference", **dotted)
    for reference in constant:
        plot.add_layout(Span(location=reference, dimension="width", line_color=GREY, line_dash="dotted"))
    caption = "marker: where braking began; dotted: the reference"
    return Drawing("plane", "Slip over speed while braking", caption, plot, tuple(legend))


def _line(plot: Any, trace: ReportTrace, column: str, colour: str, dash: str) -> tuple[str, ...]:
    """Draw a line with the session's marker at the start of braking; return their names."""
    time_s, columns = trace.points.time_s, trace.points.columns
    speed, slip = columns["road_speed_rad_s"], columns[column]
    braking = (time_s >= trace.held_s[0]) & (time_s <= trace.held_s[1]) & (speed > _SLOWEST_RAD_S)
    speed, slip = speed[braking], slip[braking]
    names = f"plane-{trace.look.letter}-{dash}", f"plane-{trace.look.letter}-{dash}-start"
    plot.line(speed, slip, name=names[0], line_color=colour, line_dash=dash, line_width=1.5)
    plot.scatter(speed[:1], slip[:1], name=names[1], marker=trace.look.marker, size=9, color=colour)
    return names


def timing_histogram(traces: Sequence[ReportTrace]) -> Drawing:
    """Histogram of the ticks' lateness, both axes logarithmic; below 1 us counts as 1 us."""
    most = max(_LEAST_SCALE_US, *(min(float(trace.late_us.max()), _LATEST_US) for trace in traces))
    edges = np.geomspace(_PUNCTUAL_US, most * 1.001, 1 + int(np.ceil(_BINS_A_DECADE * np.log10(most))))
    counts = [_histogram(trace.late_us, edges) for trace in traces]
    plot = blank("lateness", "late [us]", "ticks", x_axis_type="log", y_axis_type="log")
    plot.x_range = Range1d(_PUNCTUAL_US, 1.2 * most)
    plot.y_range = Range1d(_BELOW_ONE_TICK, 2.0 * max(float(each.max()) for each in counts))
    legend: list[LegendEntry] = []
    if len(traces) == 1:
        _bars(plot, edges, counts[0])
    else:
        legend = [_dots(plot, edges, found, trace) for trace, found in zip(traces, counts, strict=True)]
    for period_us in {_period_us(trace) for trace in traces} - {None}:
        plot.add_layout(Span(location=period_us, dimension="height", line_color=GREY, line_dash="dashed"))
    caption = "every tick of the session; below 1 us counts as 1 us; dashed: one period"
    return Drawing("lateness", "How many ticks began how late", caption, plot, tuple(legend))


def _histogram(late_us: Array, edges: Array) -> Array:
    counts = np.zeros(len(edges) - 1, np.int64)
    for at in range(0, len(late_us), _BLOCK_TICKS):  # doubles of all would take eight bytes a tick
        part = np.clip(late_us[at : at + _BLOCK_TICKS].astype(float), _PUNCTUAL_US, _LATEST_US)
        counts += np.histogram(part, edges)[0]
    return counts


def _bars(plot: Any, edges: Array, counts: Array) -> None:
    full = np.flatnonzero(counts)
    plot.quad(
        left=edges[full], right=edges[full + 1], bottom=_BELOW_ONE_TICK, top=counts[full], color=BLUE, fill_alpha=0.5
    )


def _dots(plot: Any, edges: Array, counts: Array, trace: ReportTrace) -> LegendEntry:
    look, full = trace.look, np.flatnonzero(counts)
    middles = np.sqrt(edges[full] * edges[full + 1])
    names = f"lateness-{look.letter}", f"lateness-{look.letter}-marks"
    plot.line(middles, counts[full], name=names[0], line_color=look.colour, line_width=1.5)
    plot.scatter(middles, counts[full], name=names[1], marker=look.marker, size=7, color=look.colour, fill_alpha=0.35)
    return LegendEntry(look.letter, look.colour, "solid", look.sign, names)


def _period_us(trace: ReportTrace) -> float | None:
    try:
        return float(trace.session.metadata["controller"]["sample_time_s"]) * 1e6
    except (KeyError, ValueError):
        return None
