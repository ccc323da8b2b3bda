"""What a sweep has found: a table for a terminal, and a figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from inteco_abs.montecarlo import SweepRow
from inteco_abs.views.figure import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")  # Okabe and Ito
_STYLES: Final = ("-", "--", ":", "-.")
MOST_LINES: Final = len(_COLOURS) * len(_STYLES)
_MOST_CORNERS: Final = 10_000
"""Of a line in the figure, which is narrower than that in any print."""


_SLIP: Final = "slip_rms_fixed_true"
_NOTE: Final = (
    "slip RMS: of the true slip, from 0.25 s after braking began down to 10 rad/s;\n"
    "below median and p99: the ends of their 90 % intervals; never: stops end earlier\n"
)
_NOTE_OF_TABLE: Final = (
    f"{_NOTE}locked, never in band, fell back: shares of stops; stop, N m/s: median distance, variation"
)
_NOTE_OF_RANGES: Final = f"{_NOTE}locked, ended early, fell back: shares of stops"
_MOST_RANGES: Final = 6
"""Ranges of draws for which there is a table each."""
_HEADINGS: Final = ("median", "p99", "max", "worst\nseed", "locked", "never\nin band", "stop\nm", "N m/s")
_FELL_BACK: Final = ("fell\nback",)
"""Of tables with a law that fell back."""


def render_sweep(rows: Sequence[SweepRow]) -> RenderableType:
    """A table for each range of draws, best configuration first; of many ranges one for each configuration."""
    ranges = _by_range(rows)
    tables: list[RenderableType] = [_table(name, mine) for name, mine in ranges]
    if len(ranges) <= _MOST_RANGES:
        return Group(*tables, Text(_NOTE_OF_TABLE, style="dim"))
    tables = [_table_of_ranges(name, mine) for name, mine in _by_combination(rows)]
    return Group(*tables, Text(_NOTE_OF_RANGES, style="dim"))


def _table_of_ranges(name: str, rows: Sequence[SweepRow]) -> Table:
    table = Table(title=f"{name}: slip RMS from 0.25 s on", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("rigs", overflow="fold")
    falls = any(row.summary.fell_back for row in rows)
    for heading in ("median", "p99", "max", "worst\nseed", "locked", "ended\nearly", *_FELL_BACK[:falls]):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        summary = row.summary
        table.add_row(
            Text(row.draws.name),
            *_slip_cells(row),
            f"{summary.locked:.0%}",
            f"{summary.failed / summary.stops:.0%}",
            *_fell_back(row)[:falls],
        )
    return table


def _fell_back(row: SweepRow) -> tuple[str]:
    share = row.summary.fell_back
    return ("-" if share is None else f"{share:.0%}",)


def _slip_cells(row: SweepRow) -> tuple[Text | str, ...]:
    """Median, 99th percentile and maximum of the slip's RMS, and the seed of the worst stop."""
    slip = row.summary.spreads[_SLIP]
    return (
        _with_interval(slip.median, slip.median_interval),
        _with_interval(slip.p99, slip.p99_interval),
        _number(slip.largest, ".4f"),
        str(row.seeds[slip.worst]),
    )


def _with_interval(value: float, interval: tuple[float, float]) -> Text:
    low, high = (_number(end, ".4f").removeprefix("0") for end in interval)
    return Text.assemble(_number(value, ".4f"), "\n", (f">{low}\n<{high}", "dim"))


def _by_combination(rows: Sequence[SweepRow]) -> list[tuple[str, list[SweepRow]]]:
    names = dict.fromkeys(row.combination.name for row in rows)
    return [(name, [row for row in rows if row.combination.name == name]) for name in names]


def _table(name: str, rows: Sequence[SweepRow]) -> Table:
    counts = {row.stops for row in rows}
    count = max(counts)
    most = "at most " if len(counts) > 1 else ""  # of a sweep that is under way
    title = f"{name}: slip RMS of {most}{count} {'stops' if count > 1 else 'stop'} each"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("controller on estimator", overflow="fold")
    falls = any(row.summary.fell_back for row in rows)
    for heading in (*_HEADINGS, *_FELL_BACK[:falls]):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        summary, spreads = row.summary, row.summary.spreads
        table.add_row(
            Text(row.combination.name),
            *_slip_cells(row),
            f"{summary.locked:.0%}",
            f"{summary.never_entered:.0%}",
            _number(spreads["stop_distance_m"].median, ".2f"),
            _number(spreads["torque_variation_nm_per_s"].median, ".0f"),
            *_fell_back(row)[:falls],
        )
    return table


def _by_range(rows: Sequence[SweepRow]) -> list[tuple[str, list[SweepRow]]]:
    """Ranges of draws in their order, each with its rows by the 99th percentile of the slip's RMS."""

    def p99(row: SweepRow) -> float:
        return row.summary.spreads[_SLIP].p99

    names = dict.fromkeys(row.draws.name for row in rows)
    return [(name, sorted((row for row in rows if row.draws.name == name), key=p99)) for name in names]


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "none"


def figure_of_sweep(rows: Sequence[SweepRow]) -> Figure:
    """Which share of the stops has at most which slip RMS, a panel for each range. Raises AbsError without matplotlib.

    A stop that ends within 0.25 s of its braking is beyond every RMS. Only the best MOST_LINES of a range are drawn.
    """
    ranges = _by_range(rows)
    if len(ranges) > _MOST_RANGES:
        figure = new_figure(7.0, 1.5 + 0.18 * len(ranges))
        _draw_ranges(figure.subplots(), rows)
        return figure
    names = list(dict.fromkeys(row.combination.name for row in rows))
    figure = new_figure(7.0, 1.0 + 3.6 * len(ranges))
    panels = figure.subplots(len(ranges), squeeze=False, sharex=True)[:, 0]
    for panel, (name, mine) in zip(panels, ranges, strict=True):
        for row in mine[:MOST_LINES]:
            number = names.index(row.combination.name) % MOST_LINES
            colour, style = _COLOURS[number % len(_COLOURS)], _STYLES[number // len(_COLOURS)]
            _shares(panel, row, color=colour, ls=style, lw=1.2)
        panel.set_title(name, fontsize="medium")
        panel.set_ylabel("share of stops")
        panel.set_ylim(0.0, 1.02)
        panel.grid(alpha=0.3)
        panel.legend(loc="best", frameon=False, fontsize="x-small")
    panels[-1].set_xlim(left=0.0)
    panels[-1].set_xlabel("slip RMS from 0.25 s on, true")
    return figure


def _draw_ranges(panel: Axes, rows: Sequence[SweepRow]) -> None:
    """A line for each range of draws, from the median of the slip's RMS to the 99th percentile."""
    names = list(dict.fromkeys(row.draws.name for row in rows))
    combinations = _by_combination(rows)
    for number, (combination, mine) in enumerate(combinations):
        slips = [row.summary.spreads[_SLIP] for row in mine]
        places = [names.index(row.draws.name) + 0.3 * number / len(combinations) for row in mine]
        colour = _COLOURS[number % len(_COLOURS)]
        # a stop that fails or never arrives is worse than any number
        ends = [slip.p99 if math.isfinite(slip.p99) else 1.0 for slip in slips]
        panel.hlines(places, [min(slip.median, 1.0) for slip in slips], ends, color=colour, lw=1.2)
        panel.plot([min(slip.median, 1.0) for slip in slips], places, "o", color=colour, ms=3.0, label=combination)
    panel.set_yticks(range(len(names)), names, fontsize="x-small")
    panel.set_xscale("log")
    panel.set_ylim(len(names), -1.0)
    panel.set_xlabel("slip RMS from 0.25 s on, true [1]\nmedian (dot) to 99 %; 1 where stops failed", fontsize="small")
    panel.grid(alpha=0.3, axis="x")
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, 1.05), frameon=False, fontsize="x-small", ncols=2)


def _shares(panel: Axes, row: SweepRow, **look: Any) -> None:
    values = row[_SLIP]
    finite = np.sort(values[np.isfinite(values)])
    corners = np.concatenate([finite[:1], finite])  # up from zero at the first
    shares = np.arange(len(corners)) / len(values)
    if len(corners) > _MOST_CORNERS:
        shown = np.linspace(0, len(corners) - 1, _MOST_CORNERS).round().astype(int)
        corners, shares = corners[shown], shares[shown]
    panel.step(corners, shares, where="post", label=row.combination.name, **look)
