"""Digital sliding mode control with minimum variance.

D. Mitic, S. Peric, D. Antic, Z. Jovanovic, M. Milojkovic, S. Nikolic: Digital sliding mode control of anti-lock
braking system, Advances in Electrical and Computer Engineering 13 (1), 2013, 33-40; S. Peric, D. Antic, M.
Milovanovic, D. Mitic, M. Milojkovic, S. Nikolic: Quasi-sliding mode control with orthogonal endocrine neural
network-based estimator applied in anti-lock braking system, IEEE/ASME Transactions on Mechatronics 21 (2), 2016,
754-764.

Once in each digital period the law predicts the slip one period ahead by the model and an estimate of its error, and
computes the torque that removes a share of the distance from the surface, with a weight on the torque's change: the
generalised minimum variance. The error of the last prediction, filtered, is the estimate; the papers' neural network
learns the same number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, duty_of, limited, terms
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_MOST_NM = 20.0


@dataclass(slots=True)
class VarianceState(PublishedState):
    since_s: float = 0.0
    slip: float = 0.0
    rate: float = 0.0
    """That the model predicted, 1/s."""
    missing: float = 0.0
    """Estimate of what the model misses, 1/s."""
    torque: float = 0.0
    started: bool = False


def minimum_variance(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """A new torque once in each period."""
    _, speed, slip, valid, _ = estimate
    s.since_s += dt_s
    if valid and speed > k.hold_below and (s.since_s >= k.period_s or not s.started):
        f, g = terms(k, slip, speed)
        if s.started:
            missed = (slip - s.slip) / s.since_s - s.rate
            s.missing += k.learn * (missed - s.missing)
        wanted = -(f + s.missing + k.share * (slip - s.reference) / k.period_s) / g
        weight = g * g * k.period_s * k.period_s
        s.torque = limited((weight * wanted + k.rho * s.torque) / (weight + k.rho), _MOST_NM)
        s.slip, s.rate, s.since_s, s.started = slip, f + g * max(s.torque, 0.0), 0.0, True
    return demand(duty_of(k, s.torque), s.torque, slip - s.reference, s.missing)


class MinimumVariance(PublishedLaw, VarianceState):
    """Digital sliding mode with minimum variance (Mitic and others 2013, Peric and others 2016)."""

    gains = (
        Gain("period_s", 0.005, 0.0005, 0.1, "s", "digital period"),
        Gain("share", 0.05, 0.0, 1.0, "1", "of the distance from the surface that a period removes"),
        Gain("rho", 1e-5, 0.0, 1.0, "N-2.m-2", "weight of the torque's change"),
        Gain("learn", 0.05, 0.0, 1.0, "1", "share of a new error of the prediction in its estimate"),
    )
    internals = (Quantity("missing_per_s", "1/s", "slip rate that the model misses"),)
    function = staticmethod(minimum_variance)
