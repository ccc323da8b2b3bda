"""The doctor's findings on a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from inteco_abs.host import CheckResult, Rating, worst

_COLOURS: Final = {Rating.GREEN: "green", Rating.AMBER: "yellow", Rating.RED: "red"}
_BINS_A_PERIOD: Final = 20
_LAST_BIN: Final = 2 * _BINS_A_PERIOD
_BAR: Final = 40


def render_findings(findings: Sequence[CheckResult]) -> RenderableType:
    """Table of names, verdicts, findings and what to do, with a summary."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings:
        table.add_row(Text(finding.name), _word(finding.verdict), Text(finding.found))
        for line in filter(None, finding.fix.splitlines()):
            table.add_row("", "", Text(f"-> {line}", style="dim"))
    counts = ", ".join(f"{sum(one.verdict is verdict for one in findings)} {verdict}" for verdict in Rating)
    return Group(table, Text(), Text.assemble(_word(worst(findings)), f"  {counts}"))


def render_histogram(times_us: Sequence[float], period_us: float) -> RenderableType:
    """Histogram in bins of a twentieth of the period, without empty ones; the last bin has all from two periods on."""
    width_us = period_us / _BINS_A_PERIOD
    counts = [0] * (_LAST_BIN + 1)
    for time_us in times_us:
        counts[min(int(time_us / width_us), _LAST_BIN)] += 1
    table = Table.grid(padding=(0, 1))
    table.add_column(justify="right", no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    for number, count in enumerate(counts):
        if count:
            colour = _COLOURS[Rating.GREEN if number < _BINS_A_PERIOD else Rating.RED]
            bar = "#" * max(round(_BAR * count / max(counts)), 1)  # rare values stay visible
            table.add_row(f"from {number * width_us:.0f} us", str(count), Text(bar, colour))
    return table


def _word(verdict: Rating) -> Text:
    return Text(verdict, style=f"bold {_COLOURS[verdict]}")
