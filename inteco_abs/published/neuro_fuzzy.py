"""A neuro-fuzzy network beside a PD controller, which learns by a sliding mode.

A. V. Topalov, Y. Oniz, E. Kayacan, O. Kaynak: Neuro-fuzzy control of antilock braking system using sliding mode
incremental learning algorithm, Neurocomputing 74 (11), 2011, 1883-1893; the same authors: Adaptive neuro-fuzzy
control with sliding mode learning algorithm: application to antilock braking system, Proc. 7th Asian Control
Conference, Hong Kong 2009.

The PD controller's output is the error that the network learns from: each of its nine consequents moves against the
sign of that output, in proportion to its rule's normalised strength over the strengths' squares. Here the Gaussian
sets stay where they are; the papers move their centres and widths as well.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from inteco_abs import elementary
from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, limited
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_SETS = 3
_FULL = 0.05
"""PD output, as a duty, at which the smoothed sign is full."""


@dataclass(slots=True)
class NetworkState(PublishedState):
    weights: list[float] = field(default_factory=lambda: [0.0] * (_SETS * _SETS))
    strengths: list[float] = field(default_factory=lambda: [0.0] * (_SETS * _SETS))
    slip: float = 0.0
    """Filtered."""
    started: bool = False


def _member(value: float, number: int) -> float:
    """Gaussian sets at -1, 0 and 1."""
    off = value - (number - 1.0)
    return elementary.exp(-2.0 * off * off)


def neuro_fuzzy(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """PD minus the network, which learns from the PD."""
    error = s.reference - estimate.slip
    if not s.started:
        s.slip, s.started = estimate.slip, True
    slip_rate = k.filter_rad_s * (estimate.slip - s.slip)
    s.slip += slip_rate * dt_s
    pd = k.Kp * error - k.Kd * slip_rate
    e, de = limited(error / k.width, 2.0), limited(-slip_rate / k.rate_width, 2.0)
    total, squares, network = 0.0, 0.0, 0.0
    for i in range(_SETS):
        for j in range(_SETS):
            s.strengths[_SETS * i + j] = _member(e, i) * _member(de, j)
            total += s.strengths[_SETS * i + j]
    for i in range(_SETS * _SETS):
        share = s.strengths[i] / total
        s.strengths[i] = share
        squares += share * share
        network += share * s.weights[i]
    duty = pd - network
    if 0.0 < duty < 1.0 or (duty >= 1.0) != (pd > 0.0):
        for i in range(_SETS * _SETS):
            step = k.learn * s.strengths[i] / squares * limited(pd / _FULL, 1.0) * dt_s
            s.weights[i] = limited(s.weights[i] - step, 1.0)
    return demand(duty, 0.0, -error, -network)


class NeuroFuzzy(PublishedLaw, NetworkState):
    """Neuro-fuzzy control with sliding mode learning (Topalov, Oniz, Kayacan and Kaynak 2011), beside a PD."""

    gains = (
        Gain("Kp", 1.0, 0.0, 100.0, "1", "proportional gain of the PD"),
        Gain("Kd", 0.05, 0.0, 10.0, "s", "derivative gain of the PD"),
        Gain("learn", 1.0, 0.0, 1000.0, "1/s", "learning rate of the network's output, a duty per time"),
        Gain("width", 0.1, 0.001, 10.0, "1", "slip error between two sets"),
        Gain("rate_width", 2.0, 0.01, 1000.0, "1/s", "slip rate between two sets"),
        Gain("filter_rad_s", 100.0, 1.0, 1000.0, "rad/s", "of the slip's derivative"),
    )
    internals = (Quantity("network_duty", "1", "duty of the network"),)
    function = staticmethod(neuro_fuzzy)
