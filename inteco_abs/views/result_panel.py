"""The result card as a panel on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

ROWS: Final = (
    ("start speed", "start_speed_rad_s", "{:.1f} rad/s", 1.0),
    ("reaching time", "reaching_time_s", "{:.3f} s", 1.0),
    ("band entry", "band_entry_s", "{:.3f} s", 1.0),
    ("stop time", "stop_time_s", "{:.3f} s", 1.0),
    ("stop distance", "stop_distance_m", "{:.2f} m", 1.0),
    ("slip RMS, true", "slip_rms_true", "{:.4f}", 1.0),
    ("slip RMS, estimated", "slip_rms_estimated", "{:.4f}", 1.0),
    ("slip RMS, 10..60 rad/s", "slip_rms_low_speed_true", "{:.4f}", 1.0),
    ("slip RMS, from 0.25 s", "slip_rms_fixed_true", "{:.4f}", 1.0),
    ("wheel locked", "lock_fraction", "{:.1f} %", 100.0),
    ("torque variation", "torque_variation_nm_per_s", "{:.0f} N m/s", 1.0),
    ("duty variation", "duty_variation_per_s", "{:.1f} /s", 1.0),
)
"""Label, key of the result card, format with its unit, and factor."""
FALL_BACK_ROWS: Final = (
    ("largest swing, of the band", "swing_share", "{:.0f} %", 100.0),
    ("times fallen back", "fall_backs", "{:.0f}", 1.0),
    ("fallen back for", "fall_back_s", "{:.3f} s", 1.0),
)
"""Those of a law that falls back."""
_COLOURS = {"completed": "green", "interrupted": "yellow"}


def render_card(
    card: Mapping[str, Any], explanation: str, before: Mapping[str, Any] | None = None, *, plain: bool = False
) -> RenderableType:
    """The card as a panel, with differences from the card `before`; a value that was not measured is a dash.

    A difference of two stops is no verdict: equal runs differ, too. `before["differs"]` says in what the runs do.
    `plain` uses ASCII only.
    """
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim")  # a narrow terminal breaks labels, and never a number
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    own = FALL_BACK_ROWS if card.get("swing_share") is not None else ()
    for label, key, form, factor in (*ROWS, *own) if card["stops"] else ():
        value = card[key]
        change = Text() if before is None else _change(value, before.get(key), form, factor, plain=plain)
        table.add_row(label, "-" if value is None else form.format(value * factor), change)
    late = card["lateness_us"]
    table.add_row("ticks, overruns, link errors", f"{card['ticks']}, {card['overruns']}, {card['link_errors']}")
    if late["max"] is not None:
        table.add_row("late p50 / p99 / max", f"{late['p50']:.0f} / {late['p99']:.0f} / {late['max']:.0f} us")
    outcome = str(card["outcome"])
    colour = _COLOURS.get(outcome, "red")
    head = Text.assemble((outcome.upper(), f"bold {colour}"), f"  {card['controller']} on {card['estimator']}, ")
    reference = card["reference_slip"]
    head.append("changing reference slip" if reference is None else f"reference slip {reference:g}")
    if card["rig"]:
        head.append(f", rig {card['rig']}")
    if card["stops"] > 1:
        head.append(f", median of {card['stops']} stops")
    body: list[RenderableType] = [head, table]
    if before is not None:
        differs = before.get("differs") or "same gains and seed"
        body.append(Text(f"compared with {before['session']}: {differs}", style="dim"))
    if outcome != "completed":
        body.insert(1, Text(explanation, style=colour))
    return Panel(Group(*body), title="braking stop", subtitle=Text(str(card["session"])), expand=False)


def _change(value: Any, earlier: Any, form: str, factor: float, *, plain: bool) -> Text:
    """Arrow and difference."""
    if not isinstance(value, int | float) or not isinstance(earlier, int | float):
        return Text()
    number = form.partition(" ")[0]
    difference = (value - earlier) * factor
    if number.format(value * factor) == number.format(earlier * factor):
        return Text("=", style="dim")
    up, down = ("^", "v") if plain else ("▲", "▼")
    return Text(f"{up if difference > 0.0 else down} {number.replace('{:', '{:+').format(difference)}")
