"""What a run shows of itself while it lasts, and to whom."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from enum import Enum
from typing import Final, NamedTuple, Protocol

from inteco_abs.format import TICK
from inteco_abs.realtime.histogram import Histogram
from inteco_abs.realtime.ring import RingReader
from inteco_abs.signals import Phase

_POINTS_PER_S: Final = 200
"""More than the columns of dots that any terminal has for a second."""


class Check(Enum):
    """What has to be seen before the drive is switched on, in this order."""

    BOARD = "board opened and identified"
    GUARDIAN = "guardian drilled"
    RECORDER = "recorder ready"
    REST = "wheels at rest"


class Point(NamedTuple):
    """What is drawn of a tick; the fields are columns of TICK, in its order."""

    time_ns: int
    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    phase: int


class Snapshot(NamedTuple):
    """What a screen shows of a run; read from the rings, at no cost to the loop."""

    phase: Phase
    ticks: int
    time_s: float
    """Since the first tick."""
    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    drive: float
    brake: float
    overruns: int
    late_us: tuple[float | None, ...]
    """Lateness so far: p50, p99, p99.9 and the greatest."""
    recent: tuple[Point, ...] = ()
    """200 points a second since the snapshot before."""


class Screen(Protocol):
    """Who shows a run to the user; called from the process that the user started, never from the loop's."""

    def listening(self, stop: Callable[[], None]) -> AbstractContextManager[None]:
        """While inside, the user's keys may call `stop`."""
        ...

    def passed(self, check: Check, told: str = "") -> None:
        """The start has come so far; `told` says how."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """Ten times a second."""
        ...

    def note(self, text: str) -> None:
        """What is good to know."""
        ...

    def warn(self, text: str) -> None:
        """What cannot wait until the run is over."""
        ...


class SafeScreen:
    """A screen whose trouble is not the run's: a terminal may be closed at any time."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen

    def listening(self, stop: Callable[[], None]) -> AbstractContextManager[None]:
        """The screen's own; it keeps its trouble to itself."""
        return self._screen.listening(stop)

    def passed(self, check: Check, told: str = "") -> None:
        """Tick it off, or from now on show nothing."""
        self._try(lambda: self._screen.passed(check, told))

    def show(self, snapshot: Snapshot) -> None:
        """Show it, or from now on nothing."""
        self._try(lambda: self._screen.show(snapshot))

    def note(self, text: str) -> None:
        """Say it, or from now on nothing."""
        self._try(lambda: self._screen.note(text))

    def warn(self, text: str) -> None:
        """Say it, or from now on nothing."""
        self._try(lambda: self._screen.warn(text))

    def shown(self, text: str) -> bool:
        """Warn; whether there still is somebody who shows it."""
        self.warn(text)
        return type(self._screen) is not NoScreen

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except Exception:  # noqa: BLE001  whoever drew or said it
            self._screen = NoScreen()


class NoScreen:
    """For runs that nobody looks at."""

    def listening(self, stop: Callable[[], None]) -> AbstractContextManager[None]:  # noqa: ARG002  there are no keys
        """To nobody."""
        return nullcontext()

    def passed(self, check: Check, told: str = "") -> None:
        """Nothing."""

    def show(self, snapshot: Snapshot) -> None:
        """Nothing."""

    def note(self, text: str) -> None:
        """Nothing."""

    def warn(self, text: str) -> None:
        """Nothing: the account says it too."""


class Lines(NoScreen):
    """Where there is no terminal: a log is no place for ten lines a second, but for what has to be said."""

    def __init__(
        self, say: Callable[[str], None], *, noting: bool = True, begun: Callable[[], None] = lambda: None
    ) -> None:
        self._say, self._noting, self._begun = say, noting, begun

    def passed(self, check: Check, told: str = "") -> None:  # noqa: ARG002  a log needs no more than that it goes on
        """With the board's answer there is a run; what is refused before never began."""
        if check is Check.BOARD:
            self._begun()

    def note(self, text: str) -> None:
        """One line, unless warnings only are wanted."""
        if self._noting:
            self._say(text)

    def warn(self, text: str) -> None:
        """One line."""
        self._say(text)


class SnapshotSource:
    """Makes snapshots of the ticks in a ring, taking none of them."""

    def __init__(self, ticks: RingReader, histogram: Histogram, rate_hz: float) -> None:
        self._ticks, self._histogram = ticks, histogram
        self._step = max(1, round(rate_hz / _POINTS_PER_S))
        self._next = 0
        self._first_ns = 0

    def look(self) -> Snapshot | None:
        """The newest tick, what came before it, and the timing so far; None before the first."""
        record = self._ticks.newest()
        if record is None:
            return None
        tick = TICK.array(record)[0]
        now_ns = int(tick["time_ns"])
        wheel, road, slip, drive, brake = (
            float(tick[name]) for name in ("wheel_speed_rad_s", "road_speed_rad_s", "slip", "drive", "brake")
        )
        recent = self._recent()
        self._first_ns = self._first_ns or (recent[0].time_ns if recent else now_ns)
        histogram = self._histogram
        return Snapshot(
            Phase(int(tick["phase"])),
            self._ticks.written,
            (now_ns - self._first_ns) * 1e-9,
            wheel,
            road,
            slip,
            drive,
            brake,
            histogram.skipped,
            (*histogram.quantiles_us((0.5, 0.99, 0.999)), histogram.greatest_us),
            recent,
        )

    def _recent(self) -> tuple[Point, ...]:
        records, self._next = self._ticks.sample(self._next, self._step)
        return tuple(Point(*values) for values in TICK.values(records, Point._fields))
