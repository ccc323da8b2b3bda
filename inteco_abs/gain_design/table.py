"""Table of an assessment for a terminal: the conditions over the road speed, and the advice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from inteco_abs.quantities import shown

_ROWS: Final = 6
_COLUMNS: Final = (
    ("speed\nrad/s", "road_speed_rad_s"),
    ("F\n1/s", "F_per_s"),
    ("eps_f\n1/s", "eps_f_per_s"),
    ("eps_g\n", "eps_g"),
    ("Mq (25)\n1/s", "mq_25_per_s"),
    ("Mq (26)\n1/s", "mq_26_per_s"),
    ("given\n1/s", "mq_per_s"),
    ("M1eq\nN m", "torque_eq_nm"),
    ("of all\nN m", "torque_eq_least_nm"),
    ("Mq/g\nN m", "torque_swing_nm"),
)
_LOOP_COLUMNS: Final = (
    "speed\nrad/s",
    "delay\nms",
    "slip seen\nwithin",
    "bears\n1/s",
    "law\n1/s",
    "margin\nms",
    "swings\nby",
    "times\na second",
)


def render_design(report: Mapping[str, Any]) -> RenderableType:
    """The report of an assessment as a panel; a dash for infinite values."""
    body = [_facts(report), Text(), _table(report["curves"]), Text()]
    if report["loop"]:
        body += [_loop(report["loop"]), Text()]
    for one in report["advice"]:
        body += [
            Text.assemble((one["about"], "bold yellow"), f": {one['found']}"),
            Text(f"  -> {one['next_step']}", "dim"),
        ]
    if not report["advice"]:
        width = report["gains"].get("width", 0.0)
        what = f"slip within {width:g} of the reference" if width else "sliding"
        body.append(Text(f"{what} is guaranteed for the whole set, within the brake's limits", "green"))
    return Panel(Group(*body), title="design", expand=False)


def _facts(report: Mapping[str, Any]) -> RenderableType:
    gains = ", ".join(f"{name} = {value:g}" for name, value in report["gains"].items())
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("law", Text(f"{report['controller']}, {gains}, reference slip {report['reference_slip']:g}"))
    low, high = report["slips"]
    if low != high:
        table.add_row("conditions for", Text(f"slips {low:g}..{high:g}"))
    spreads = (f"{name} {low:.4g}..{high:.4g}" for name, (low, high) in report["uncertain"].items())
    table.add_row("uncertain", Text(", ".join(spreads) or "nothing"))
    if report["brake"]:
        late = "lag {least_lag_s:g}..{most_lag_s:g} s, dead time up to {dead_time_s:g} s".format(**report["brake"])
        table.add_row("brakes", Text(late))
    limit = f"{report['largest_torque_nm']:.3g} N m at its duty limit {report['brake_limit']:g}"
    table.add_row("brake", Text(limit))
    for way in report["reaching"]:
        table.add_row(f"from slip {way['from_slip']:g}", Text("; ".join(_reaching(way))))
    slip, torque = (max(report["curves"][name]) for name in ("slip_ripple_rms", "torque_ripple_nm"))
    table.add_row("chattering", Text(f"slip up to {slip:.2g} rms, torque up to ±{torque:.3g} N m, in an ideal loop"))
    return table


def _reaching(way: Mapping[str, Any]) -> Iterator[str]:
    yield "no bound by (20)" if way["bound_s"] is None else f"{way['bound_s']:.4f} s by (20)"
    yield "never reached" if way["time_s"] is None else f"{way['time_s']:.4f} s within the brake's limits"
    yield f"asks for {way['lowest_torque_nm']:.2f}..{way['peak_torque_nm']:.2f} N m"


def _table(curves: Mapping[str, Any]) -> RenderableType:
    table = Table.grid(padding=(0, 1))
    for head, _ in _COLUMNS:
        table.add_column(Text(head, style="dim"), justify="right", no_wrap=True)
    table.show_header = True
    last = len(curves["road_speed_rad_s"]) - 1
    for row in range(_ROWS):
        at = row * last // (_ROWS - 1)
        cells = [shown(curves[key][at]) for _, key in _COLUMNS]
        band = cells[8], shown(curves["torque_eq_most_nm"][at])
        table.add_row(*cells[:8], "..".join(band), cells[9])
    return table


def _loop(rows: Sequence[Mapping[str, Any]]) -> RenderableType:
    """The loop with lag, dead time, sampling and estimator; a dash for infinite values."""
    table = Table.grid(padding=(0, 1))
    for head in _LOOP_COLUMNS:
        table.add_column(Text(head, style="dim"), justify="right", no_wrap=True)
    table.show_header = True
    for row in rows:
        ms = (1e3 * row["delay_s"], None if row["delay_margin_s"] is None else 1e3 * row["delay_margin_s"])
        gains = row["most_gain_per_s"], row["gain_per_s"]
        cells = (row["road_speed_rad_s"], ms[0], row["estimator_error"], *gains, ms[1], row["amplitude"])
        table.add_row(*map(shown, cells), shown(row["frequency_hz"]) if row["amplitude"] != 0.0 else "")
    return table
