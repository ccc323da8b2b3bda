"""L1 adaptive control of the slip.

N. Hovakimyan, C. Cao: L1 adaptive control theory, SIAM, Philadelphia 2010, section 2.1.

The slip error obeys e' = -am*e + g*(u + sigma) around the torque that holds the reference by the model. A predictor
of it and a projected adaptation give sigma; the torque cancels sigma through a low-pass filter, and so decouples
adaptation from robustness.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, duty_of, limited, terms
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_MOST_NM = 8.0
"""Of the uncertainty, by projection."""


@dataclass(slots=True)
class L1State(PublishedState):
    predicted: float = 0.0
    sigma: float = 0.0
    filtered: float = 0.0
    torque: float = 0.0
    started: bool = False


def l1_adaptive(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Predictor, adaptation, filter."""
    _, speed, slip, valid, _ = estimate
    error = slip - s.reference
    if valid and speed > k.hold_below:
        f, g = terms(k, s.reference, speed)
        held = -f / g
        if not s.started:
            s.predicted, s.started = error, True
        ahead = s.predicted - error
        s.sigma = limited(s.sigma - k.gamma * ahead * g * dt_s, _MOST_NM)
        s.filtered += k.bandwidth * (-s.sigma - s.filtered) * dt_s
        s.torque = held + s.filtered - k.am * error / g
        # the torque that the brake can have is what the predictor gets
        given = min(max(s.torque, 0.0), k.full_nm) - held + k.am * error / g
        s.predicted += (-k.am * s.predicted + g * (given + s.sigma)) * dt_s
    return demand(duty_of(k, s.torque), s.torque, error, s.sigma)


class L1Adaptive(PublishedLaw, L1State):
    """L1 adaptive control (Hovakimyan and Cao 2010) of the slip error around the model's equilibrium."""

    gains = (
        Gain("am", 5.0, 0.01, 1000.0, "1/s", "wanted decay of the slip error"),
        Gain("gamma", 2000.0, 0.0, 1e7, "N2.m2", "adaptation gain"),
        Gain("bandwidth", 10.0, 0.1, 1000.0, "rad/s", "of the filter"),
        Gain("full_nm", 12.0, 1.0, 50.0, "N.m", "largest torque of the brake that the predictor assumes"),
    )
    internals = (Quantity("sigma_nm", "N.m", "estimated disturbance sigma"),)
    function = staticmethod(l1_adaptive)
