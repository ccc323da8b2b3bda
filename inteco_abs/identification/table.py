"""Table of an identification for a terminal: each parameter with its interval and published value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

_STYLES: Final = {"identified": "", "assumed": "dim", "not identified": "yellow"}


def render_identification(report: Mapping[str, Any]) -> RenderableType:
    """The report of an identification as a panel."""
    table = Table.grid(padding=(0, 1))
    for head, justify in (("number", "left"), ("value", "right"), ("95 % interval", "right"), ("unit", "left")):
        table.add_column(Text(head, style="dim"), justify=justify, no_wrap=True)  # type: ignore[arg-type]  # literals
    table.add_column(Text("published", style="dim"), justify="right", no_wrap=True)
    table.show_header = True
    within, reasons = report["assumed_within"], []
    for each in report["estimates"]:
        name, why = each["name"], each["why"]
        if each["status"] == "assumed":
            name = f"{name}, assumed ±{100.0 * within[name]:.3g} %"
        elif why:
            reasons.append(Text(f"{name}: {why}", _STYLES[each["status"]]))
        published = "-" if each["published"] is None else f"{each['published']:.4g}"
        interval = f"{each['low']:.4g} .. {each['high']:.4g}"
        table.add_row(name, f"{each['value']:.4g}", interval, each["unit"], published, style=_STYLES[each["status"]])
    worst = max((one["rms_counts"] for one in report["residuals"]), default=math.nan)
    summary = f"residuals: at most {worst:.2g} counts rms in one of {len(report['residuals'])} traces"
    return Panel(Group(table, Text(), *reasons, Text(summary, "dim")), title="identification", expand=False)
