"""The oracle: the predictive controller with full knowledge of its rig: what knowledge is worth.

Another law may do better with less.
It knows the rig's parameters and true state at every sample, but not the future; the brake has its dead time and lag.
It takes the brake for one without hysteresis, and the wheel for one that does not wear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from inteco_abs import elementary
from inteco_abs.config import RigConfig
from inteco_abs.control import (
    Controller,
    DelayLine,
    Estimator,
    PredictiveReaching,
    Setup,
    WheelDynamics,
    braking_slip,
    gains_in_force,
    outlook,
)
from inteco_abs.montecarlo.policies import TrueState
from inteco_abs.rig import LONGEST_DEAD_TIME_S, RigVariation, adhesion, brake_duty, measured_duty
from inteco_abs.rig.brake_actuator import settled
from inteco_abs.rig.state import Constants
from inteco_abs.signals import Command, Estimate, Prediction, Sample

_LEAST_SLIP: Final = 0.001
"""Below, the adhesion of (8) passes through zero."""
_LEAST_LAG_S: Final = 0.0025
"""The inverse of the gain kM: a brake with a shorter lag, as of `nominal`, gets the torque of the law."""


@dataclass(frozen=True, slots=True)
class Oracle:
    """PolicyFactory of an estimator and a controller that know the rig; `config` must name `predictive-reaching`."""

    config: RigConfig

    def __call__(self, variation: RigVariation, state: TrueState) -> tuple[Estimator, Controller]:
        """Estimator and controller of one rig."""
        config = self.config.controller
        setup = Setup(config.reference_slip, variation.parameters, config.hold_below_rad_s)
        controller = _Informed(setup, **gains_in_force(self.config))
        controller.variation, controller.state = variation, state
        return _OracleEstimator(variation, state, self.config.period_ns / 1e9), controller


class _Informed(PredictiveReaching):
    variation: RigVariation
    state: TrueState

    def duty(self, torque: float) -> float:
        """Duty by the true map of the rig's brake."""
        rig = self.variation
        if torque <= 0.0:
            return 0.0
        own = torque / (rig.brake_gain * self.state.fade)
        mapped = measured_duty(own) if rig.brake_map == "measured" else brake_duty(own, rig.parameters)
        duty, sag = max(mapped + rig.brake_duty_offset, 0.0), rig.supply_sag
        if sag > 0.0:  # the terminals get duty - sag * duty**2
            duty = (1.0 - math.sqrt(max(0.0, 1.0 - 4.0 * sag * duty))) / (2.0 * sag)
        return min(duty, 1.0)


class _OracleEstimator:
    """Predicts as the observer does, from the true state."""

    def __init__(self, variation: RigVariation, state: TrueState, period_s: float) -> None:
        self._variation = variation
        self._state = state
        self._contact = WheelDynamics(variation.parameters)
        self._constants = Constants.of(variation)
        self._pending = DelayLine(period_s, LONGEST_DEAD_TIME_S)

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:  # noqa: ARG002  it looks at the rig
        """True state and prediction at the time of `sample`."""
        state = self._state
        self._pending.tell(settled(self._constants, command.brake) * state.fade, 1)
        x1, x2 = state.wheel_speed, state.road_speed
        seen = None
        if command.drive == 0.0 and x2 > 0.0:
            seen = self._outlook(x1, x2)
        return Estimate(x1, x2, state.slip, valid=True, outlook=seen)

    def _outlook(self, x1: float, x2: float) -> Prediction:
        rig, k, state = self._variation, self._variation.parameters, self._state
        slip = max(braking_slip(x1, x2, k), _LEAST_SLIP)
        factor = state.adhesion(slip) / adhesion(slip, k)
        sine_of_phase, cosine_of_phase = elementary.sin_cos(rig.load_ripple_phase_rad)
        cosine, sine = factor * rig.load_ripple * sine_of_phase, factor * rig.load_ripple * cosine_of_phase
        now = (state.wheel_angle, x1, 0.0, x2, state.brake_torque, 0.0, factor, cosine, sine)
        lag_s = max(1.0 / k.c31, _LEAST_LAG_S)
        return outlook(
            self._contact,
            self._pending.k,
            self._pending,
            (*now, rig.brake_dead_time_s, lag_s, rig.brake_release_ratio),
            1.0,
            rig.brake_release_ratio,
        )
