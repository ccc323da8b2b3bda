"""What a real-time run shows of itself while it lasts, and to whom."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from inteco_abs.signals import Phase


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


class Screen(Protocol):
    """Who shows a run to the user; called from the supervisor's process, never from the loop's."""

    def show(self, snapshot: Snapshot) -> None:
        """Ten times a second."""
        ...

    def warn(self, text: str) -> None:
        """What cannot wait until the run is over."""
        ...


class Unbreakable:
    """A screen whose trouble is not the run's: a terminal may be closed at any time."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen

    def show(self, snapshot: Snapshot) -> None:
        """Show it, or from now on nothing."""
        try:
            self._screen.show(snapshot)
        except Exception:  # noqa: BLE001  whoever drew it
            self._screen = NoScreen()

    def warn(self, text: str) -> None:
        """Say it, or from now on nothing."""
        try:
            self._screen.warn(text)
        except Exception:  # noqa: BLE001  whoever said it
            self._screen = NoScreen()


class NoScreen:
    """For runs that nobody looks at."""

    def show(self, snapshot: Snapshot) -> None:
        """Nothing."""

    def warn(self, text: str) -> None:
        """Nothing: the account says it too."""
