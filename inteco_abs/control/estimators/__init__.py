"""Estimators of wheel speeds and slip from counts."""

from typing import Final

from inteco_abs.control.estimators import difference, edge_time, kalman, moving_window, observer, tracking
from inteco_abs.control.estimators.base import Estimator, SpeedFilter, TwoWheels
from inteco_abs.control.estimators.difference import HeldDifference
from inteco_abs.control.estimators.edge_time import EdgeTime
from inteco_abs.control.estimators.kalman import KalmanFilter
from inteco_abs.control.estimators.moving_window import MovingWindow
from inteco_abs.control.estimators.observer import Observer
from inteco_abs.control.estimators.registry import EstimatorSpec, Parameter, require_estimator
from inteco_abs.control.estimators.tracking import TrackingLoop
from inteco_abs.entry_points import Registry

_SHIPPED: Final[dict[str, EstimatorSpec]] = {
    "euler": moving_window.EULER,
    "moving-window": moving_window.SPEC,
    "difference": difference.SPEC,
    "edge-time": edge_time.SPEC,
    "tracking": tracking.SPEC,
    "kalman": kalman.SPEC,
    "observer": observer.SPEC,
    "adaptive-observer": observer.ADAPTIVE,
}
ESTIMATORS: Final = Registry("an estimator", "inteco_abs.estimators", "estimator.name", _SHIPPED, require_estimator)
"""Estimators by name: those that ship and those of installed packages."""

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
