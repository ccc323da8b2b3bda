"""Wheel speeds and slip from counts. The same filter on both wheels, always: equal lag cancels in the slip."""

from __future__ import annotations

from typing import Final, Protocol

from inteco_abs.config import RigConfig
from inteco_abs.control.windows import SpeedWindow
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Estimate, Sample


class Estimator(Protocol):
    """Turns samples into estimates, one at a time, in order; no clock, no randomness."""

    def update(self, sample: Sample) -> Estimate:
        """Estimate at the instant of `sample`."""
        ...


class WindowEstimator:
    """Speeds as mean over the last `length` periods of both wheels.

    `counts_per_turn` and radii are those of the rig. The slip is that of braking, equation (11), clipped to 0..1:
    equation (8) is not defined outside, and a driven or resting wheel reads 0.
    """

    __slots__ = ("_ratio", "_road", "_samples", "_wheel")

    def __init__(self, counts_per_turn: int, length: int, parameters: RigParameters) -> None:
        self._wheel = SpeedWindow(counts_per_turn, length)
        self._road = SpeedWindow(counts_per_turn, length)
        self._ratio = parameters.r1 / parameters.r2
        self._samples = 0

    def update(self, sample: Sample) -> Estimate:
        """Estimate at the instant of `sample`; valid from the second sample on."""
        wheel = self._wheel.update(sample.time_ns, sample.wheel_count)
        road = self._road.update(sample.time_ns, sample.road_count)
        slip = 1.0 - self._ratio * wheel / road if road > 0.0 else 0.0
        self._samples += 1
        return Estimate(wheel, road, 0.0 if slip < 0.0 else min(slip, 1.0), self._samples > 1)


def _euler(config: RigConfig, parameters: RigParameters) -> Estimator:
    return WindowEstimator(config.encoders.counts_per_turn, 1, parameters)


def _moving_window(config: RigConfig, parameters: RigParameters) -> Estimator:
    length = max(1, round(config.estimator.window_s * config.loop.rate_hz))
    return WindowEstimator(config.encoders.counts_per_turn, length, parameters)


ESTIMATORS: Final = {
    "euler": _euler,
    "moving-window": _moving_window,
}
"""Name to maker: `euler` is the paper's backward difference over one period."""
