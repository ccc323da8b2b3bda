"""Model-free control: an intelligent PD controller.

M. Fliess, C. Join: Model-free control, International Journal of Control 86 (12), 2013, 2228-2252.

The slip obeys an ultra-local model, slip'' = F + alpha*duty, whose F is found from the slip's second derivative and
the duty, both through the same second-order filter. The duty cancels F and adds a PD of the error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate


@dataclass(slots=True)
class IntelligentState(PublishedState):
    slip: float = 0.0
    slip_rate: float = 0.0
    filtered: float = 0.0
    """Duty, through the filter."""
    filtered_rate: float = 0.0
    duty: float = 0.0


def intelligent_pd(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Cancel the estimated F, and add the PD."""
    w = k.filter_rad_s
    second = w * w * (estimate.slip - s.slip) - 2.0 * w * s.slip_rate
    s.slip_rate += second * dt_s
    s.slip += s.slip_rate * dt_s
    s.filtered_rate += (w * w * (s.duty - s.filtered) - 2.0 * w * s.filtered_rate) * dt_s
    s.filtered += s.filtered_rate * dt_s
    unknown = second - k.alpha * s.filtered
    error = estimate.slip - s.reference
    wanted = -(unknown + k.Kp * error + k.Kd * s.slip_rate) / k.alpha
    s.duty = min(max(wanted, 0.0), 1.0)
    return demand(s.duty, 0.0, error, unknown)


class IntelligentPd(PublishedLaw, IntelligentState):
    """Model-free control (Fliess and Join 2013): an ultra-local model of second order and an intelligent PD."""

    gains = (
        Gain("alpha", 200.0, 0.1, 1e6, "1/s2", "slip's second derivative per duty"),
        Gain("Kp", 300.0, 0.0, 1e6, "1/s2", "proportional gain"),
        Gain("Kd", 35.0, 0.0, 1e5, "1/s", "gain of the derivative"),
        Gain("filter_rad_s", 60.0, 1.0, 1000.0, "rad/s", "of the filter of slip and duty"),
    )
    internals = (Quantity("F_per_s2", "1/s2", "estimated F of the ultra-local model"),)
    function = staticmethod(intelligent_pd)
