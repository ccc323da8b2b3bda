"""Wheel speeds and slip from counts, one filter a file."""

from collections.abc import Callable
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.base import Estimator, SpeedFilter, TwoWheels
from inteco_abs.control.estimators.kalman import KalmanFilter
from inteco_abs.control.estimators.tracking import TrackingLoop
from inteco_abs.control.windows import SpeedWindow
from inteco_abs.rig import RigParameters

Maker = Callable[[RigConfig, RigParameters], Estimator]


def _on_both_wheels(make: Callable[[RigConfig], SpeedFilter]) -> Maker:
    return lambda config, parameters: TwoWheels(make(config), make(config), parameters)


def _moving_window(config: RigConfig) -> SpeedFilter:
    return SpeedWindow(config.encoders.counts_per_turn, max(1, round(config.estimator.window_s * config.loop.rate_hz)))


def _tracking(config: RigConfig) -> SpeedFilter:
    return TrackingLoop(config.encoders.counts_per_turn, config.estimator.natural_frequency_rad_s)


def _kalman(config: RigConfig) -> SpeedFilter:
    return KalmanFilter(config.encoders.counts_per_turn, config.estimator.jerk_density)


ESTIMATORS: Final[dict[str, Maker]] = {
    "euler": _on_both_wheels(lambda config: SpeedWindow(config.encoders.counts_per_turn, 1)),
    "moving-window": _on_both_wheels(_moving_window),
    "tracking": _on_both_wheels(_tracking),
    "kalman": _on_both_wheels(_kalman),
}
"""Name to maker: `euler` is the paper's backward difference over one period."""

__all__ = [
    "ESTIMATORS",
    "Estimator",
    "KalmanFilter",
    "SpeedFilter",
    "TrackingLoop",
    "TwoWheels",
]
