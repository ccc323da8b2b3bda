"""Gain-scheduled linear quadratic control of the slip.

I. Petersen, T. A. Johansen, J. Kalkkuhl, J. Luedemann: Wheel slip control in ABS brakes using gain scheduled
constrained LQR, Proc. European Control Conference, Porto 2001.

Slip error and its integral are the states, the brake torque the input, and the model is linearised at the reference
for each speed. For these two states the Riccati equation has a closed form, with e' = alpha*e + beta*u and weights
q1, q2, 1: k1 = sqrt(q1), k2 = (alpha + sqrt(alpha^2 + 2*beta*k1 + beta^2*q2))/beta. The limits of the explicit
constrained form are those of the duty; the integral is held there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, duty_of, terms
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_STEP = 0.01
"""Of the slip, for the derivative."""


@dataclass(slots=True)
class LqrState(PublishedState):
    integral: float = 0.0
    torque: float = 0.0


def lqr(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """State feedback around the torque that holds the reference."""
    _, speed, slip, valid, _ = estimate
    error = slip - s.reference
    if valid and speed > k.hold_below:
        f, beta = terms(k, s.reference, speed)
        held = -f / beta
        f_more, g_more = terms(k, s.reference + _STEP, speed)
        f_less, g_less = terms(k, s.reference - _STEP, speed)
        alpha = (f_more + g_more * held - f_less - g_less * held) / (2.0 * _STEP)
        k1 = math.sqrt(k.q1)
        k2 = (alpha + math.sqrt(alpha * alpha + 2.0 * beta * k1 + beta * beta * k.q2)) / beta
        wanted = held - k1 * s.integral - k2 * error
        duty = duty_of(k, wanted)
        if 0.0 < duty < 1.0 or (duty >= 1.0) == (error > 0.0):
            s.integral += error * dt_s
        s.torque = wanted
    return demand(duty_of(k, s.torque), s.torque, error, s.integral)


class Lqr(PublishedLaw, LqrState):
    """Gain-scheduled LQR (Petersen and others 2001) on the configured model of the rig, as `identify` finds it."""

    gains = (
        Gain("q1", 1e4, 0.0, 1e9, "N2.m2/s2", "weight of the integral, per weight of the torque"),
        Gain("q2", 100.0, 0.0, 1e7, "N2.m2", "weight of the slip error"),
    )
    internals = (Quantity("integral_s", "s", "integral of the slip error"),)
    function = staticmethod(lqr)
