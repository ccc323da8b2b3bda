"""A run while it happens, on a terminal: drawn by the process that the user started, from a copy of the newest tick."""

from __future__ import annotations

from types import TracebackType
from typing import Final, Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from inteco_abs.realtime.screen import Snapshot
from inteco_abs.signals import Phase

_SHOWN: Final = (Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED)
_NARROW: Final = 60
_BAR: Final = 28
HINT: Final = "Ctrl-C stops safely"
_STARTING: Final = Text("starting: first of all, the guardian has to prove itself", style="dim")


class Dashboard:
    """Shows snapshots on a terminal in place; one line on a narrow one. A context manager."""

    def __init__(self, console: Console, full_speed_rad_s: float) -> None:
        self._console = console
        self._full_speed = full_speed_rad_s
        # no thread refreshes it: what draws is what was asked to, when it was asked
        self._live = Live(_STARTING, console=console, auto_refresh=False, transient=True)

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Draw the newest state."""
        narrow = self._console.width < _NARROW
        self._live.update(in_one_line(snapshot) if narrow else panel(snapshot, self._full_speed), refresh=True)

    def warn(self, text: str) -> None:
        """Print what cannot wait, above the live part."""
        self._console.print(Text(text, style="bold red"))


def in_one_line(snapshot: Snapshot) -> Text:
    """Phase, speeds, slip and overruns, shortened to the terminal."""
    line = Text(no_wrap=True, overflow="ellipsis")
    line.append(_named(snapshot.phase), style="bold")
    line.append(f" {snapshot.road_speed_rad_s:.0f} rad/s, slip {snapshot.slip:.2f}, ")
    line.append(f"{snapshot.overruns} overruns", style="red" if snapshot.overruns else "")
    line.append(f", {HINT}")
    return line


def panel(snapshot: Snapshot, full_speed_rad_s: float) -> RenderableType:
    """Phases, speeds, slip, duties as bars, and the timing so far."""
    phases = Text(" > ").join(
        Text(_named(phase), style="bold reverse" if phase is snapshot.phase else "dim") for phase in _SHOWN
    )
    table = Table.grid(padding=(0, 2))
    for label, value, full, form in (
        ("road speed", snapshot.road_speed_rad_s, full_speed_rad_s, "{:6.1f} rad/s"),
        ("wheel speed", snapshot.wheel_speed_rad_s, full_speed_rad_s, "{:6.1f} rad/s"),
        ("slip", snapshot.slip, 1.0, "{:6.3f}"),
        ("drive duty", snapshot.drive, 1.0, "{:6.2f}"),
        ("brake duty", snapshot.brake, 1.0, "{:6.2f}"),
    ):
        bar = ProgressBar(total=full, completed=min(max(value, 0.0), full), width=_BAR, finished_style="bar.complete")
        table.add_row(Text(label, style="dim"), bar, form.format(value))
    title = f"{snapshot.time_s:.1f} s, {snapshot.ticks} ticks"
    return Panel(Group(phases, table, timing(snapshot)), title=title, subtitle=HINT, expand=False)


def timing(snapshot: Snapshot) -> Text:
    """Lateness so far and periods missed, the latter red."""
    p50, p99, p999, greatest = (f"{value:.0f}" if value is not None else "-" for value in snapshot.late_us)
    line = Text(f"late p50 {p50}, p99 {p99}, p99.9 {p999}, max {greatest} us; ", style="dim")
    missed = snapshot.overruns
    return line.append(f"{missed} periods missed", style="bold red" if missed else "")


def _named(phase: Phase) -> str:
    return phase.name.lower().replace("_", "-")
