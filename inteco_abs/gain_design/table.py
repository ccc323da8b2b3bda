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


_CERTIFICATE_COLUMNS: Final = (
    "speed\nrad/s",
    "decay\n1/s",
    "least\ngain",
    "most\ngain",
    "earlier\nms",
    "later\nms",
    "least\nlag ms",
    "most\nlag ms",
    "all\nthree",
    "this\nset",
)


def render_design(report: Mapping[str, Any]) -> RenderableType:
    """The report of an assessment as a panel; a dash for infinite values."""
    body = [_facts(report), Text(), _table(report["curves"]), Text()]
    if report["loop"]:
        body += [_loop(report["loop"]), Text()]
    width = report["gains"].get("width", 0.0)
    what = f"slip within {width:g} of the reference" if width else "sliding"
    sure = f"{what} is guaranteed for the whole set, within the brake's limits"
    return Panel(Group(*body, *_advised(report, sure)), title="design", expand=False)


def _advised(report: Mapping[str, Any], sure: str) -> Iterator[Text]:
    """All advice, or `sure` without any."""
    for one in report["advice"]:
        yield Text.assemble((one["about"], "bold yellow"), f": {one['found']}")
        yield Text(f"  -> {one['next_step']}", "dim")
    if not report["advice"]:
        yield Text(sure, "green")


def _facts(report: Mapping[str, Any]) -> RenderableType:
    gains = ", ".join(f"{name} = {value:g}" for name, value in report["gains"].items())
    table = _grid(("law", f"{report['controller']}, {gains}, reference slip {report['reference_slip']:g}"))
    low, high = report["slips"]
    if low != high:
        table.add_row("conditions for", Text(f"slips {low:g}..{high:g}"))
    table.add_row("uncertain", Text(_spreads(report)))
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


def _grid(first: tuple[str, str]) -> Table:
    """Names and what they are."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row(first[0], Text(first[1]))
    return table


def _columns(heads: Sequence[str]) -> Table:
    """Numbers under these heads."""
    table = Table.grid(padding=(0, 1))
    for head in heads:
        table.add_column(Text(head, style="dim"), justify="right", no_wrap=True)
    table.show_header = True
    return table


def _spreads(report: Mapping[str, Any]) -> str:
    spreads = (f"{name} {low:.4g}..{high:.4g}" for name, (low, high) in report["uncertain"].items())
    return ", ".join(spreads) or "nothing"


def _reaching(way: Mapping[str, Any]) -> Iterator[str]:
    yield "no bound by (20)" if way["bound_s"] is None else f"{way['bound_s']:.4f} s by (20)"
    yield "never reached" if way["time_s"] is None else f"{way['time_s']:.4f} s within the brake's limits"
    yield f"asks for {way['lowest_torque_nm']:.2f}..{way['peak_torque_nm']:.2f} N m"


def _table(curves: Mapping[str, Any]) -> RenderableType:
    table = _columns([head for head, _ in _COLUMNS])
    last = len(curves["road_speed_rad_s"]) - 1
    for row in range(_ROWS):
        at = row * last // (_ROWS - 1)
        cells = [shown(curves[key][at]) for _, key in _COLUMNS]
        band = cells[8], shown(curves["torque_eq_most_nm"][at])
        table.add_row(*cells[:8], "..".join(band), cells[9])
    return table


def render_certificate(report: Mapping[str, Any]) -> RenderableType:
    """The report of a certificate as a panel."""
    expected, brake = report["expected"], report["brake"]
    facts = _grid(("law", f"{report['controller']} on {report['estimator']}, slip {report['reference_slip']:g}"))
    brakes = "a dead time of {dead_time_s:g} s, a lag of {least_lag_s:g} s"
    facts.add_row("expects", Text(brakes.format(**expected)))
    if brake:
        late = "lag {least_lag_s:g}..{most_lag_s:g} s, dead time up to {dead_time_s:g} s".format(**brake)
        facts.add_row("brakes", Text(late))
    facts.add_row("uncertain", Text(_spreads(report)))
    facts.add_row("gain", Text(f"off by up to {100.0 * report['gain_error']:.1f} % in this set"))
    facts.add_row("radii", Text(f"r1/r2 1 % larger: slip off by {report['slip_offset']:g}, no less stable"))
    table = _columns(_CERTIFICATE_COLUMNS)
    for row in report["loop"]:
        ms = (1e3 * row[name] for name in ("earlier_s", "later_s", "least_lag_s", "most_lag_s"))
        cells = (row["road_speed_rad_s"], row["decay_per_s"], row["least_gain"], row["most_gain"], *ms)
        table.add_row(*map(shown, cells), shown(row["together"], ".0%"), "yes" if row["certified"] else "no")
    sure = "the loop holds its reference for the whole set, as far as it is linear"
    return Panel(Group(facts, Text(), table, Text(), *_advised(report, sure)), title="design", expand=False)


def _loop(rows: Sequence[Mapping[str, Any]]) -> RenderableType:
    """The loop with lag, dead time, sampling and estimator; a dash for infinite values."""
    table = _columns(_LOOP_COLUMNS)
    for row in rows:
        ms = (1e3 * row["delay_s"], None if row["delay_margin_s"] is None else 1e3 * row["delay_margin_s"])
        gains = row["most_gain_per_s"], row["gain_per_s"]
        cells = (row["road_speed_rad_s"], ms[0], row["estimator_error"], *gains, ms[1], row["amplitude"])
        table.add_row(*map(shown, cells), shown(row["frequency_hz"]) if row["amplitude"] != 0.0 else "")
    return table
