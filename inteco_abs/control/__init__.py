"""The decision path, pure: no clock, no I/O, no randomness, scalar floats. That is what makes replay exact."""

from inteco_abs.control.assembly import build_pipeline, control_check, gains_in_force
from inteco_abs.control.controllers import CONTROLLERS, Controller, Gain, ReachingLaw, Relay, Setup
from inteco_abs.control.estimators import (
    ESTIMATORS,
    EdgeTime,
    Estimator,
    HeldDifference,
    KalmanFilter,
    SpeedFilter,
    TrackingLoop,
    TwoWheels,
)
from inteco_abs.control.guard import Guard
from inteco_abs.control.model import BrakingModel, reaching_law_torque, reaching_time_bound
from inteco_abs.control.pipeline import Pipeline
from inteco_abs.control.sequence import Sequence
from inteco_abs.control.windows import SpeedWindow

__all__ = [
    "CONTROLLERS",
    "ESTIMATORS",
    "BrakingModel",
    "Controller",
    "EdgeTime",
    "Estimator",
    "Gain",
    "Guard",
    "HeldDifference",
    "KalmanFilter",
    "Pipeline",
    "ReachingLaw",
    "Relay",
    "Sequence",
    "Setup",
    "SpeedFilter",
    "SpeedWindow",
    "TrackingLoop",
    "TwoWheels",
    "build_pipeline",
    "control_check",
    "gains_in_force",
    "reaching_law_torque",
    "reaching_time_bound",
]
