"""Sliding mode with a switching gain that adapts: by a Lyapunov function, and by a reaching law.

E. Chereji, M.-B. Radac, A.-I. Szedlak-Stinean: Sliding mode control algorithms for anti-lock braking systems with
performance comparisons, Algorithms 14 (1), 2021, article 2.

Both compute the equivalent torque of the rig's model. The first adds a switching rate alone, the second the reaching
law's proportional part, too. The switching gain grows with the distance from the surface, and here it leaks, as noise
and lag keep the state from the surface; the sign is a saturation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, duty_of, limited, terms
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_ADAPTIVE = (
    Gain("q", 0.3, 0.0, 1000.0, "1/s", "switching rate at first, and at least"),
    Gain("gamma", 10.0, 0.0, 1e5, "1/s2", "growth of the switching rate per slip error and time"),
    Gain("leak", 1.0, 0.0, 1000.0, "1/s", "decay of what has grown"),
    Gain("width", 0.05, 1e-4, 1.0, "1", "slip error at which the switching is full"),
)


@dataclass(slots=True)
class AdaptiveState(PublishedState):
    grown: float = 0.0
    torque: float = 0.0


def _adaptive(k: Any, s: Any, estimate: Estimate, dt_s: float, proportional: float) -> BrakeDemand:
    _, speed, slip, valid, _ = estimate
    error = slip - s.reference
    if valid and speed > k.hold_below:
        f, g = terms(k, slip, speed)
        s.grown += (k.gamma * abs(error) - k.leak * s.grown) * dt_s
        s.torque = -(f + proportional * error + (k.q + s.grown) * limited(error / k.width, 1.0)) / g
    return demand(duty_of(k, s.torque), s.torque, error, k.q + s.grown)


def lyapunov_sliding(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Equivalent torque and an adaptive switching rate."""
    return _adaptive(k, s, estimate, dt_s, 0.0)


def reaching_sliding(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """With the proportional part of the reaching law."""
    return _adaptive(k, s, estimate, dt_s, k.Mk)


class LyapunovSliding(PublishedLaw, AdaptiveState):
    """Adaptive sliding mode by a Lyapunov function (Chereji, Radac and Szedlak-Stinean 2021)."""

    gains = _ADAPTIVE
    internals = (Quantity("rate_per_s", "1/s", "switching rate in force"),)
    function = staticmethod(lyapunov_sliding)


class ReachingSliding(PublishedLaw, AdaptiveState):
    """Adaptive sliding mode by a reaching law (Chereji, Radac and Szedlak-Stinean 2021)."""

    gains = (Gain("Mk", 5.0, 0.0, 1000.0, "1/s", "proportional rate"), *_ADAPTIVE)
    internals = (Quantity("rate_per_s", "1/s", "switching rate in force"),)
    function = staticmethod(reaching_sliding)
