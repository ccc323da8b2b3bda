"""Slip controllers, one class each."""

from typing import Final

from inteco_abs.control.controllers.base import LAG, Controller, Gain, ModelLaw, Setup
from inteco_abs.control.controllers.linear import ProportionalIntegral, Steps
from inteco_abs.control.controllers.predictive import SWING_BAND, PredictiveReaching
from inteco_abs.control.controllers.reaching import (
    BoundaryLayer,
    ConstantRate,
    ExponentialRate,
    PowerRate,
    ReachingLaw,
    SuperTwisting,
)
from inteco_abs.control.controllers.relay import Relay, SmithRelay

CONTROLLERS: Final[dict[str, type[Controller]]] = {
    "reaching-law": ReachingLaw,
    "constant-rate": ConstantRate,
    "power-rate": PowerRate,
    "exponential-rate": ExponentialRate,
    "boundary-layer": BoundaryLayer,
    "super-twisting": SuperTwisting,
    "relay": Relay,
    "smith-relay": SmithRelay,
    "pi": ProportionalIntegral,
    "steps": Steps,
    "predictive-reaching": PredictiveReaching,
}
"""Controllers that ship, by the name on the command line."""

__all__ = [
    "CONTROLLERS",
    "LAG",
    "SWING_BAND",
    "BoundaryLayer",
    "ConstantRate",
    "Controller",
    "ExponentialRate",
    "Gain",
    "ModelLaw",
    "PowerRate",
    "PredictiveReaching",
    "ProportionalIntegral",
    "ReachingLaw",
    "Relay",
    "Setup",
    "SmithRelay",
    "Steps",
    "SuperTwisting",
]
