"""Screens: what a run shows while it lasts."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from enum import Enum
from typing import Any, Final, NamedTuple, Protocol

from inteco_abs.format import TICK
from inteco_abs.realtime.histogram import Histogram
from inteco_abs.realtime.ring import RingReader
from inteco_abs.signals import Phase

POINTS_PER_S: Final = 200
"""More than a terminal has dots for a second."""


class StartCheck(Enum):
    """Checks before the drive is switched on, in this order."""

    BOARD = "board opened and identified"
    GUARDIAN = "guardian drilled"
    RECORDER = "recorder ready"
    REST = "wheels at rest"


class Point(NamedTuple):
    """The drawn columns of a tick, in the order of TICK."""

    time_ns: int
    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    phase: int
    slip_reference: float = math.nan
    """Slip to hold; NaN unless the phase is braking."""
    torque_demand_nm: float = 0.0
    """Brake torque that the law asks for."""
    drive: float = 0.0
    brake: float = 0.0


class Snapshot(NamedTuple):
    """State of a run for a screen, read from the rings at no cost to the loop."""

    phase: Phase
    ticks: int
    time_s: float
    """Seconds since the first tick."""
    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    drive: float
    brake: float
    overruns: int
    late_us: tuple[float | None, ...]
    """Lateness so far, us: p50, p99, p99.9 and the greatest; None before the first tick."""
    recent: tuple[Point, ...] = ()
    """200 points a second since the last snapshot."""


class Screen(Protocol):
    """Shows a run to the user, in the process that the user started, never in the loop's."""

    period_s: float
    """Time between two states that it shows."""

    def listening(self, stop: Callable[[], None]) -> AbstractContextManager[None]:
        """Return a context in which the user's keys may call `stop`."""
        ...

    def passed(self, check: StartCheck, detail: str = "") -> None:
        """Show that a check has passed, with its `detail`."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """Show the state; called every `period_s`."""
        ...

    def note(self, text: str) -> None:
        """Show a remark."""
        ...

    def warn(self, text: str) -> None:
        """Show what cannot wait until the run is over."""
        ...


class SafeScreen:
    """A screen whose failure does not end the run, such as a closed terminal; after one it shows nothing."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self.period_s = screen.period_s

    def listening(self, stop: Callable[[], None]) -> AbstractContextManager[None]:
        """Return the screen's own context."""
        return self._screen.listening(stop)

    def passed(self, check: StartCheck, detail: str = "") -> None:
        """Show that a check has passed."""
        self._try(lambda: self._screen.passed(check, detail))

    def show(self, snapshot: Snapshot) -> None:
        """Show the state."""
        self._try(lambda: self._screen.show(snapshot))

    def note(self, text: str) -> None:
        """Show a remark."""
        self._try(lambda: self._screen.note(text))

    def warn(self, text: str) -> None:
        """Show a warning."""
        self._try(lambda: self._screen.warn(text))

    def shown(self, text: str) -> bool:
        """Show a warning; return whether a screen is still there."""
        self.warn(text)
        return type(self._screen) is not NoScreen

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except Exception:  # noqa: BLE001  of any screen
            self._screen = NoScreen()


class NoScreen:
    """A screen that shows nothing."""

    period_s = 0.1

    def listening(self, stop: Callable[[], None]) -> AbstractContextManager[None]:  # noqa: ARG002  there are no keys
        """Return an empty context."""
        return nullcontext()

    def passed(self, check: StartCheck, detail: str = "") -> None:
        """Ignore the check."""

    def show(self, snapshot: Snapshot) -> None:
        """Ignore the state."""

    def note(self, text: str) -> None:
        """Ignore the remark."""

    def warn(self, text: str) -> None:
        """Ignore the warning: the result has it too."""


class Lines(NoScreen):
    """A screen for a log: remarks and warnings only, one line each."""

    def __init__(
        self, say: Callable[[str], None], *, noting: bool = True, begun: Callable[[], None] = lambda: None
    ) -> None:
        self._say, self._noting, self._begun = say, noting, begun

    def passed(self, check: StartCheck, detail: str = "") -> None:  # noqa: ARG002  a log does not need it
        """Call `begun` once the board has answered: what is refused before is not a run."""
        if check is StartCheck.BOARD:
            self._begun()

    def note(self, text: str) -> None:
        """Print one line, if remarks are wanted."""
        if self._noting:
            self._say(text)

    def warn(self, text: str) -> None:
        """Print one line."""
        self._say(text)


class SnapshotSource:
    """Makes snapshots of the ticks in a ring, and takes none of them."""

    def __init__(self, ticks: RingReader, histogram: Histogram, rate_hz: float) -> None:
        self._ticks, self._histogram = ticks, histogram
        self._step = max(1, round(rate_hz / POINTS_PER_S))
        self._next = 0
        self._first_ns = 0

    def look(self) -> Snapshot | None:
        """Return the newest tick, the points before it, and the timing so far; None before the first tick."""
        record = self._ticks.newest()
        if record is None:
            return None
        tick = TICK.array(record)[0]
        recent, now_ns = self._recent(), int(tick["time_ns"])
        self._first_ns = self._first_ns or (recent[0].time_ns if recent else now_ns)
        return snapshot_of(tick, self._ticks.written, (now_ns - self._first_ns) * 1e-9, self._histogram, recent)

    def _recent(self) -> tuple[Point, ...]:
        records, self._next = self._ticks.sample(self._next, self._step)
        return tuple(Point(*values) for values in TICK.values(records, Point._fields))


def snapshot_of(tick: Any, ticks: int, time_s: float, histogram: Histogram, recent: tuple[Point, ...]) -> Snapshot:
    """The snapshot at a row `tick`, which is `ticks` ticks and `time_s` seconds after the first."""
    wheel, road, slip, drive, brake = (
        float(tick[name]) for name in ("wheel_speed_rad_s", "road_speed_rad_s", "slip", "drive", "brake")
    )
    state = (wheel, road, slip, drive, brake)
    late_us = (*histogram.quantiles_us((0.5, 0.99, 0.999)), histogram.greatest_us)
    return Snapshot(Phase(int(tick["phase"])), ticks, time_s, *state, histogram.skipped, late_us, recent)
