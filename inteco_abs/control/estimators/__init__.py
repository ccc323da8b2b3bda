"""Wheel speeds and slip from counts, one filter a file."""

from collections.abc import Callable
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.base import Estimator, MovingWindow, SpeedFilter, TwoWheels
from inteco_abs.control.estimators.braking_ekf import EkfTuning
from inteco_abs.control.estimators.difference import SLIP_OFFSET_M_S, HeldDifference
from inteco_abs.control.estimators.edge_time import EdgeTime
from inteco_abs.control.estimators.kalman import KalmanFilter
from inteco_abs.control.estimators.observer import Observer
from inteco_abs.control.estimators.registry import EstimatorSpec, Maker, Parameter, parameter, require_estimator
from inteco_abs.control.estimators.tracking import TrackingLoop
from inteco_abs.entry_points import Registry
from inteco_abs.rig import RigParameters, nominal_brake_map


def _on_both_wheels(make: Callable[[RigConfig], SpeedFilter]) -> Maker:
    return lambda config, parameters: TwoWheels(make(config), make(config), parameters)


def _euler(config: RigConfig, parameters: RigParameters) -> Estimator:
    return MovingWindow(config.encoders.counts_per_turn, 1, parameters)


def _moving_window(config: RigConfig, parameters: RigParameters) -> Estimator:
    length = max(1, round(config.estimator.window_s * config.loop.rate_hz))
    return MovingWindow(config.encoders.counts_per_turn, length, parameters)


def _edge_time(config: RigConfig) -> SpeedFilter:
    return EdgeTime(config.encoders.counts_per_turn, config.estimator.window_s)


def _tracking(config: RigConfig) -> SpeedFilter:
    return TrackingLoop(config.encoders.counts_per_turn, config.estimator.natural_frequency_rad_s)


def _kalman(config: RigConfig) -> SpeedFilter:
    return KalmanFilter(config.encoders.counts_per_turn, config.estimator.jerk_density)


def _difference(config: RigConfig, parameters: RigParameters) -> Estimator:
    per_turn, window_s, period_s = config.encoders.counts_per_turn, config.estimator.window_s, 1.0 / config.loop.rate_hz
    wheel = HeldDifference(per_turn, parameters.r1, window_s, period_s)
    road = HeldDifference(per_turn, parameters.r2, window_s, period_s)
    return TwoWheels(wheel, road, parameters, SLIP_OFFSET_M_S)


def _observer(config: RigConfig, parameters: RigParameters) -> Estimator:
    own = config.model.identified
    spread = EkfTuning(
        dead_time_s=EkfTuning().dead_time_s if own.brake_dead_time_s is None else own.brake_dead_time_s,
        lag_s=EkfTuning().lag_s if own.c31 is None else 1.0 / own.c31,
    )
    per_turn, brake_map = config.encoders.counts_per_turn, nominal_brake_map(config.model)
    return Observer(parameters, per_turn, 1.0 / config.loop.rate_hz, spread, brake_map)


_SHIPPED: Final[dict[str, EstimatorSpec]] = {
    "euler": EstimatorSpec(
        "The paper's backward difference over one period",
        (),
        _euler,
        MovingWindow,
    ),
    "moving-window": EstimatorSpec(
        "Mean speed over a window of samples",
        (parameter("window_s", "s", "length of the window; the speed lags by half of it"),),
        _moving_window,
        MovingWindow,
    ),
    "difference": EstimatorSpec(
        "The vendor's demonstrations: difference over T0, held for T0, behind a dead zone of 0.05 m/s",
        (parameter("window_s", "s", "T0; the speed lags by as much in the mean"),),
        _difference,
        HeldDifference,
    ),
    "edge-time": EstimatorSpec(
        "Angle between edges over the time between them, known to a sample as no board stamps edges",
        (parameter("window_s", "s", "least time between the two edges; the speed lags by half of it"),),
        _on_both_wheels(_edge_time),
        EdgeTime,
    ),
    "tracking": EstimatorSpec(
        "A model wheel that follows the counted angle through a spring and a damper",
        (parameter("natural_frequency_rad_s", "rad/s", "quicker and noisier if higher; at most rate_hz/10"),),
        _on_both_wheels(_tracking),
        TrackingLoop,
    ),
    "kalman": EstimatorSpec(
        "Kalman filter of angle, speed and acceleration for a wheel whose jerk is white noise",
        (parameter("jerk_density", "rad2/s5", "quicker and noisier if higher"),),
        _on_both_wheels(_kalman),
        KalmanFilter,
    ),
    "observer": EstimatorSpec(
        "Extended Kalman filter of wheels, brake and contact, which learns the encoders' discs in the run-up",
        (),
        _observer,
        Observer,
    ),
}
"""By the name on the command line."""

ESTIMATORS: Final = Registry("an estimator", "inteco_abs.estimators", "estimator.name", _SHIPPED, require_estimator)
"""What there is to choose from: what ships and what installed packages offer."""

__all__ = [
    "ESTIMATORS",
    "EdgeTime",
    "Estimator",
    "EstimatorSpec",
    "HeldDifference",
    "KalmanFilter",
    "MovingWindow",
    "Observer",
    "Parameter",
    "SpeedFilter",
    "TrackingLoop",
    "TwoWheels",
]
