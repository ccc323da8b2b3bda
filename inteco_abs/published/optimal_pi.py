"""PI control of the slip, and its Takagi-Sugeno fuzzy form.

M.-B. Radac, R.-E. Precup: Data-driven model-free slip control of anti-lock braking systems using reinforcement
Q-learning, Neurocomputing 2017, doi 10.1016/j.neucom.2017.08.036, which compares with an optimal PI;
M.-B. Radac, R.-E. Precup, S. Preitl, J. K. Tar, K. J. Burnham: Tire slip fuzzy control of a laboratory anti-lock
braking system, Proc. European Control Conference, Budapest 2009, 940-945; R.-E. Precup, S. Preitl, M. Balas, V.
Balas: Fuzzy controllers for tire slip control in anti-lock braking systems, Proc. IEEE International Conference on
Fuzzy Systems, Budapest 2004.

The PI controller is incremental, du = Kp*(de + mu*e) with mu = Ts/Ti. Its fuzzy form has three triangular sets for e
and three for de, product and sum, and local PI laws as consequents; where error and increment have the same sign the
local gain is eta times as large.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, limited
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_PI = (
    Gain("Kp", 1.0, 0.0, 100.0, "1", "proportional gain, duty per slip"),
    Gain("Ti", 0.2, 0.001, 100.0, "s", "integral time"),
)


@dataclass(slots=True)
class IncrementalState(PublishedState):
    duty: float = 0.0
    error: float = 0.0
    started: bool = False


def _increments(k: Any, s: Any, slip: float, dt_s: float) -> tuple[float, float]:
    """Increment of the error, and its part of the integral; the first increment is 0."""
    error = s.reference - slip
    change = error - s.error if s.started else 0.0
    s.error, s.started = error, True
    return change, error * dt_s / k.Ti


def optimal_pi(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Incremental PI; the limited duty is the next one's start, so that nothing winds up."""
    change, share = _increments(k, s, estimate.slip, dt_s)
    s.duty = min(max(s.duty + k.Kp * (change + share), 0.0), 1.0)
    return demand(s.duty, 0.0, -s.error)


def fuzzy_pi(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """The same with a gain that two fuzzy inputs choose."""
    change, share = _increments(k, s, estimate.slip, dt_s)
    e, de = limited(s.error / k.Be, 1.0), limited(change / (k.Be * dt_s / k.Ti), 1.0)
    together = max(e, 0.0) * max(de, 0.0) + max(-e, 0.0) * max(-de, 0.0)
    gain = k.Kp * (1.0 + (k.eta - 1.0) * together)
    s.duty = min(max(s.duty + gain * (change + share), 0.0), 1.0)
    return demand(s.duty, 0.0, -s.error, gain)


class OptimalPi(PublishedLaw, IncrementalState):
    """Optimal PI (Radac and others 2009), incremental; optimal are the gains that the benchmark's search finds."""

    gains = _PI
    function = staticmethod(optimal_pi)


class FuzzyPi(PublishedLaw, IncrementalState):
    """Takagi-Sugeno PI-fuzzy control (Precup and others 2004, Radac and others 2009)."""

    gains = (
        *_PI,
        Gain("Be", 0.2, 0.001, 10.0, "1", "slip error at which its sets are full"),
        Gain("eta", 0.5, 0.01, 10.0, "1", "ratio of the gain where error and increment have the same sign"),
    )
    internals = (Quantity("gain", "1", "proportional gain in force"),)
    function = staticmethod(fuzzy_pi)
