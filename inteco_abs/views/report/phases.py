"""Phases as bands behind the curves."""

from __future__ import annotations

from typing import Any, Final

from bokeh.models import Label, Span

from inteco_abs.signals import Phase
from inteco_abs.views.figure import COLOURS
from inteco_abs.views.report.traces import ReportTrace

_BLUE, _RED, _GREEN = COLOURS
_BANDS: Final = {
    Phase.SPIN_UP: ("spin-up", "#e69f00", " "),
    Phase.BRAKING: ("braking", _BLUE, " "),
    Phase.STOPPED: ("stopped", _GREEN, " "),
    Phase.FAULT: ("fault", _RED, "right_diagonal_line"),
}
"""Name, colour and hatch; the other phases have no band."""
_SHORTEST_NAMED_S: Final = 0.15
_MOST_NAMED: Final = 20


def draw_bands(plot: Any, trace: ReportTrace) -> None:
    """Draw the bands of the phases behind `plot`."""
    for phase, (_, colour, hatch) in _BANDS.items():
        bands = [band for band in trace.bands if band.phase is phase]
        plot.vstrip(
            x0=[band.start_s for band in bands],
            x1=[band.end_s for band in bands],
            fill_color=colour,
            fill_alpha=0.09,
            line_color=None,
            hatch_pattern=hatch,
            hatch_color=colour,
            hatch_alpha=0.3,
            level="underlay",
        )
    for band in trace.bands:
        if band.phase is Phase.FAULT:  # often too short for a band
            plot.add_layout(Span(location=band.start_s, dimension="height", line_color=_RED, line_width=2))


def name_bands(plot: Any, trace: ReportTrace) -> None:
    """Label the first bands of `plot`, whose y range is fixed."""
    named = [band for band in trace.bands if band.phase in _BANDS]
    named = [band for band in named if band.phase is Phase.FAULT or band.end_s - band.start_s >= _SHORTEST_NAMED_S]
    for band in named[:_MOST_NAMED]:
        plot.add_layout(
            Label(
                x=band.start_s,
                y=plot.y_range.end,
                text=_BANDS[band.phase][0],
                x_offset=4,
                y_offset=-4,
                text_baseline="top",
                text_font_size="11px",
            )
        )
