"""Phases and traces of the present stop, for the dashboard."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from inteco_abs.realtime import Point
from inteco_abs.sessions import Array
from inteco_abs.signals import Phase

_SPANS: Final = (1.0, 2.0, 5.0)
_USUAL_DECELERATION: Final = 120.0
"""rad/s2 of the road wheel; the published rig brakes with 128, so that a usual stop ends within the axis."""
_EMPTY: Final = np.zeros((0, 5))


class RunTrace:
    """Trace of a run's present stop; the next stop begins a new trace."""

    def __init__(self, start_speed_rad_s: float) -> None:
        self.stop = 0
        """Number of the stop, from 1; 0 before the first."""
        self.entered_ns: dict[Phase, int] = {}
        """When each phase of the present stop began."""
        self._usual_s = _at_least(start_speed_rad_s / _USUAL_DECELERATION)
        self._phase = Phase.UNKNOWN
        self._rows: list[tuple[float, ...]] = []
        self._newest_ns = 0
        self._braked_s = 0.0

    def add(self, points: Iterable[Point]) -> None:
        """Add points."""
        for point in points:
            if point.phase != self._phase:
                self._enter(Phase(point.phase), point.time_ns)
            self._newest_ns = point.time_ns
            if Phase.BRAKING in self.entered_ns and self._phase in {Phase.BRAKING, Phase.STOPPED}:
                since_s = (point.time_ns - self.entered_ns[Phase.BRAKING]) * 1e-9
                speeds = point.road_speed_rad_s, point.wheel_speed_rad_s
                self._rows.append((since_s, *speeds, point.slip, point.slip_reference))
                if self._phase is Phase.BRAKING:  # holding the brake afterwards does not lengthen the axis
                    self._braked_s = since_s

    def _enter(self, phase: Phase, time_ns: int) -> None:
        if phase is Phase.IDLE or not self.stop:
            self.stop += 1
            self.entered_ns.clear()
            self._rows.clear()
            self._braked_s = 0.0
        self.entered_ns.setdefault(phase, time_ns)
        self._phase = phase

    def braked(self) -> bool:
        """Whether there is a trace to draw."""
        return bool(self._rows)

    def seconds_in(self, phase: Phase) -> float | None:
        """Duration of a phase so far, s; None if it was not entered."""
        begin = self.entered_ns.get(phase)
        if begin is None:
            return None
        later = [time for time in self.entered_ns.values() if time > begin]
        return (min(later, default=self._newest_ns) - begin) * 1e-9

    def columns(self) -> tuple[Array, Array, Array, Array, Array]:
        """Time since braking began in s, speed of road and wheel in rad/s, slip, and slip to hold or NaN."""
        times, road, wheel, slip, reference = (np.array(self._rows) if self._rows else _EMPTY).T
        return times, road, wheel, slip, reference

    def span_s(self) -> float:
        """Length of the time axis, s: that of a usual stop, longer in steps if this one takes longer."""
        return _at_least(max(self._usual_s, self._braked_s))


def _at_least(seconds: float) -> float:
    """The next larger of ... 0.5, 1, 2, 5, 10 ... s."""
    decade = 0.1
    while True:
        for step in _SPANS:
            if step * decade >= seconds:
                return round(step * decade, 6)
        decade *= 10.0
