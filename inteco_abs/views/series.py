"""Statistics and curves of a series of stops."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from inteco_abs.analysis import UNITS, MetricStatistics
from inteco_abs.errors import AbsError
from inteco_abs.sessions import Session
from inteco_abs.views.comparison import held_spans, since_s, start_ns
from inteco_abs.views.decimation import Decimated, decimate
from inteco_abs.views.figure import BEFORE_S, check_figure, highest_slip, moving_slip, new_figure, save_figure, slip_top
from inteco_abs.views.result_panel import ROWS

_HEADINGS: Final = ("n", "mean", "std dev", "smallest", "largest", "per stop")
_PANELS: Final = (
    ("wheel_speed_rad_s", "wheel speed [rad/s]"), ("slip", "slip, estimated"), ("brake", "brake duty"),
)  # fmt: skip
_POINTS: Final = 4000
"""Points of each line; without a limit, a thousand stops take gigabytes."""


def render_series(spreads: Mapping[str, MetricStatistics]) -> Table:
    """Table of metrics: number of stops, spread, and drift per stop."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("metric", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for heading in _HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    labels = {key: label for label, key, *_ in ROWS}
    for name, (stops, *numbers) in spreads.items():
        table.add_row(labels[name], UNITS[name], str(stops), *map(_number, numbers))
    return table


def _number(value: float | None) -> str:
    """Three digits, without exponent."""
    if value is None:
        return "-"
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def draw_series(sessions: Iterable[Session], path: Path) -> None:
    """Draw wheel speed, estimated slip and brake duty of each stop, dark to light, to `path` (.png, .svg or .pdf).

    Sessions are read one after the other; those that never braked are left out. Raises AbsError if none braked.
    """
    check_figure(path)
    from matplotlib import colormaps  # noqa: PLC0415  heavy, and an extra

    curves = [found for session in sessions if (found := _curves(session)) is not None]
    if not curves:
        raise AbsError("no stop of the series braked; there is nothing to draw")
    figure = new_figure(7.1, 6.5)
    panels = figure.subplots(len(_PANELS), sharex=True)
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(curves)))
    for number, ((drawn, _), colour) in enumerate(zip(curves, colours, strict=True), 1):
        label = f"{number} of {len(curves)}" if number in {1, len(curves)} else None
        for panel, (name, _) in zip(panels, _PANELS, strict=True):
            panel.plot(drawn.time_s, drawn.columns[name], color=colour, lw=0.8, alpha=0.8, label=label)
    for panel, (_, label) in zip(panels, _PANELS, strict=True):
        panel.set_ylabel(label)
        panel.grid(alpha=0.3)
    panels[0].legend(loc="upper right", frameon=False, fontsize="small", title="stop")
    panels[1].set_ylim(0.0, slip_top(highest for _, highest in curves))
    panels[-1].set_xlabel("time since braking began [s]")
    save_figure(figure, path)


def _curves(session: Session) -> tuple[Decimated, float] | None:
    """Curves of one stop, and its largest slip; None without braking."""
    ticks = session.ticks
    held = held_spans(session)
    if not held:
        return None
    time_s = since_s(ticks, start_ns(session))
    shown = (time_s >= -BEFORE_S) & (np.arange(len(ticks)) < held[-1].end)
    values = {name: ticks[name][shown] for name, _ in _PANELS}
    values["slip"] = moving_slip(ticks[shown])
    drawn = decimate(values, time_s[shown], np.zeros(int(shown.sum()), bool), _POINTS)
    return drawn, max(highest_slip(ticks[span.first : span.end]) for span in held)
