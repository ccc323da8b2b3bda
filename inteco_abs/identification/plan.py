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
_COAST_RATE_HZ: Final = 500.0
_COAST_TIMEOUT_S: Final = 120.0
"""A coast-down from 180 rad/s takes about 48 s (docs/facts/rig.md#checks-of-a-simulation)."""
_SLOW_TIMEOUT_S: Final = 20.0


class PlannedRun(NamedTuple):
    """One run of the plan."""

    name: str
    """Name for the session's file."""
    shows: str
    """What the run shows."""
    settings: tuple[str, ...]
    """Settings as for `--set`."""


def experiments(brake_limit: float) -> tuple[PlannedRun, ...]:
    """The runs to record, with brake duties up to the guard's `brake_limit`."""
    stops = [
        PlannedRun(f"stop-{duty * 100:03.0f}", f"one brake step, to {duty:g}", _steps(duty, 0.0, 60.0))
        for duty in _STOPS
        if duty <= brake_limit
    ]
    released = min(_RELEASED, brake_limit)
    return (
        PlannedRun(
            "coast",
            "run-up and coast-down to standstill",
            (*_steps(0.0, 0.0, 60.0, _COAST_TIMEOUT_S), f"loop.rate_hz={_COAST_RATE_HZ}"),
        ),
        PlannedRun(
            "stair",
            f"brake steps up from {_STAIR_FIRST:g}, {_STAIR_RISE:g} each",
            _steps(_STAIR_FIRST, _STAIR_RISE, _STAIR_STEP_S),
        ),
        *stops,
        PlannedRun(
            "release",
            f"one brake step, to {released:g}, and its release",
            (*_steps(released, -released, _HELD_S, _COAST_TIMEOUT_S), f"loop.rate_hz={_COAST_RATE_HZ}"),
        ),
    )


def _steps(first: float, rise: float, length_s: float, timeout_s: float = _SLOW_TIMEOUT_S) -> tuple[str, ...]:
    return (
        "controller.name=steps",
        f"controller.gains.first={first:g}",
        f"controller.gains.rise={rise:g}",
        f"controller.gains.length_s={length_s:g}",
        f"experiment.braking_timeout_s={timeout_s:g}",
        "experiment.stops=1",
    )
