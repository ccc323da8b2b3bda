"""The runs from which a rig can be identified, with the open-loop controller `steps`."""

from __future__ import annotations

from typing import Final, NamedTuple

_STOPS: Final = (0.55, 0.60, 0.65, 0.70, 0.80, 0.90, 1.00)
"""Duties of single brake steps: below about 0.7 the wheel keeps rolling, above it locks."""
_STAIR_FIRST: Final = 0.45
_STAIR_RISE: Final = 0.025
_STAIR_STEP_S: Final = 0.25
"""Five lags of the brake, so that each step settles."""
_RELEASED: Final = 0.70
_HELD_S: Final = 0.4
"""The wheels still turn at more than 100 rad/s when the brake is released."""
_SHORTLY_S: Final = 0.2
_FOR_GOOD_S: Final = 60.0
_COAST_RATE_HZ: Final = 500.0
_COAST_TIMEOUT_S: Final = 120.0
"""A coast-down from 180 rad/s takes about 48 s (docs/facts/rig.md#checks-of-a-simulation)."""
_SLOW_TIMEOUT_S: Final = 20.0


class PlannedRun(NamedTuple):
    """One run of the plan: steps of the brake's duty, from `first` on by `rise` after each `length_s`, within 0..1."""

    name: str
    """Name for the session's file."""
    shows: str
    """What the run shows."""
    first: float
    rise: float = 0.0
    length_s: float = _FOR_GOOD_S

    @property
    def coasts(self) -> bool:
        """Whether the wheels coast to standstill."""
        return self.first + self.rise <= 0.0

    @property
    def settings(self) -> tuple[str, ...]:
        """Settings as for `--set`."""
        return (
            "controller.name=steps",
            f"controller.gains.first={self.first:g}",
            f"controller.gains.rise={self.rise:g}",
            f"controller.gains.length_s={self.length_s:g}",
            f"experiment.braking_timeout_s={_COAST_TIMEOUT_S if self.coasts else _SLOW_TIMEOUT_S:g}",
            "experiment.stops=1",
            *((f"loop.rate_hz={_COAST_RATE_HZ}",) if self.coasts else ()),
        )


def experiments(brake_limit: float) -> tuple[PlannedRun, ...]:
    """The runs to record, with brake duties up to the guard's `brake_limit`."""
    return (
        PlannedRun("coast", "run-up and coast-down to standstill", 0.0),
        PlannedRun(
            "stair",
            f"brake steps up from {_STAIR_FIRST:g}, {_STAIR_RISE:g} each",
            _STAIR_FIRST,
            _STAIR_RISE,
            _STAIR_STEP_S,
        ),
        *(
            PlannedRun(f"stop-{duty * 100:03.0f}", f"one brake step, to {duty:g}", duty)
            for duty in _STOPS
            if duty <= brake_limit
        ),
        _release("release", min(_RELEASED, brake_limit), _HELD_S),
    )


def further_experiments(brake_limit: float) -> tuple[PlannedRun, ...]:
    """Releases from other duties than that of `experiments`, after a long and a short time."""
    return tuple(
        _release(f"release-{duty * 100:03.0f}{'-short' * (held_s == _SHORTLY_S)}", duty, held_s)
        for duty in _STOPS
        for held_s in (_HELD_S, _SHORTLY_S)
        if duty <= brake_limit and (duty, held_s) != (_RELEASED, _HELD_S)
    )


def _release(name: str, duty: float, held_s: float) -> PlannedRun:
    shows = f"one brake step, to {duty:g}, and its release" + f" after {held_s:g} s" * (held_s != _HELD_S)
    return PlannedRun(name, shows, duty, -duty, held_s)
