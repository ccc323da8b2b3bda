"""The decision path, pure: no clock, no I/O, no randomness, scalar floats. That is what makes replay exact."""

from inteco_abs.control.controllers import (
    CONTROLLERS,
    BoundaryLayer,
    Controller,
    Gain,
    PredictiveReaching,
    ReachingLaw,
    Relay,
    Setup,
)
from inteco_abs.control.count_speed import MovingAverageSpeed
from inteco_abs.control.estimators import (
    ESTIMATORS,
    EdgeTime,
    Estimator,
    EstimatorSpec,
    HeldDifference,
    KalmanFilter,
    MovingWindow,
    Observer,
    Parameter,
    SpeedFilter,
    TrackingLoop,
    TwoWheels,
)
from inteco_abs.control.estimators.prediction import DelayLine, braking_slip, outlook
from inteco_abs.control.factory import (
    build_pipeline,
    config_of_stop,
    control_check,
    gains_in_force,
    make_controller,
    make_estimator,
    preferred_estimator,
)
from inteco_abs.control.functions import Function, finite_demand, finite_estimate, function_of
from inteco_abs.control.guard import Guard
from inteco_abs.control.phase_machine import REST_COUNTS, PhaseMachine, demand_of
from inteco_abs.control.pipeline import OVER, DecisionState, Pipeline, advance_and_admit
from inteco_abs.control.reference import reference_function
from inteco_abs.control.slip_dynamics import (
    BrakingModel,
    SlipConstants,
    reaching_law_torque,
    reaching_time_bound,
    slip_terms,
)
from inteco_abs.control.wheel_dynamics import WheelDynamics

__all__ = [
    "CONTROLLERS",
    "ESTIMATORS",
    "OVER",
    "REST_COUNTS",
    "BoundaryLayer",
    "BrakingModel",
    "Controller",
    "DecisionState",
    "DelayLine",
    "EdgeTime",
    "Estimator",
    "EstimatorSpec",
    "Function",
    "Gain",
    "Guard",
    "HeldDifference",
    "KalmanFilter",
    "MovingAverageSpeed",
    "MovingWindow",
    "Observer",
    "Parameter",
    "PhaseMachine",
    "Pipeline",
    "PredictiveReaching",
    "ReachingLaw",
    "Relay",
    "Setup",
    "SlipConstants",
    "SpeedFilter",
    "TrackingLoop",
    "TwoWheels",
    "WheelDynamics",
    "advance_and_admit",
    "braking_slip",
    "build_pipeline",
    "config_of_stop",
    "control_check",
    "demand_of",
    "finite_demand",
    "finite_estimate",
    "function_of",
    "gains_in_force",
    "make_controller",
    "make_estimator",
    "outlook",
    "preferred_estimator",
    "reaching_law_torque",
    "reaching_time_bound",
    "reference_function",
    "slip_terms",
]
