"""Sliding mode on a slip that a grey model predicts.

E. Kayacan, Y. Oniz, O. Kaynak: A grey system modeling approach for sliding-mode control of antilock braking system,
IEEE Transactions on Industrial Electronics 56 (8), 2009, 3244-3252; on this rig in Y. Oniz, E. Kayacan, O. Kaynak: A
dynamic method to forecast the wheel slip for antilock braking system and its experimental evaluation, IEEE
Transactions on Systems, Man, and Cybernetics B 39 (2), 2009, 551-560.

A rolling GM(1,1) is fitted to the last five slips. The slip that it predicts takes the place of the measured one in a
sliding mode law with equivalent control, whose sign is smoothed as s/(|s| + delta).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from inteco_abs import elementary
from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, duty_of, limited, terms
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_LENGTH = 5
_LEAST = 1e-9


@dataclass(slots=True)
class GreyState(PublishedState):
    slips: list[float] = field(default_factory=lambda: [0.0] * _LENGTH)
    """Oldest first."""
    since_s: float = 0.0
    predicted: float = 0.0
    torque: float = 0.0


def predict(slips: Any, steps: float) -> float:
    """The slip that GM(1,1) predicts `steps` samples ahead: x(1) sums x(0), and x(0) + a*z = b with z its means."""
    total, sz, szz, sx, szx = slips[0], 0.0, 0.0, 0.0, 0.0
    for i in range(1, _LENGTH):
        z = total + 0.5 * slips[i]
        total += slips[i]
        sz, szz, sx, szx = sz + z, szz + z * z, sx + slips[i], szx + z * slips[i]
    count = _LENGTH - 1.0
    determinant = count * szz - sz * sz
    if determinant < _LEAST:
        return float(slips[_LENGTH - 1])
    a, b = (sz * sx - count * szx) / determinant, (sx * szz - sz * szx) / determinant
    a = limited(a, 1.0)
    if abs(a) < _LEAST:
        return min(max(b, 0.0), 1.0)
    grown = elementary.exp(-a * (_LENGTH + steps - 1.0))
    ahead: float = (1.0 - elementary.exp(a)) * (slips[0] - b / a) * grown
    return min(max(ahead, 0.0), 1.0)


def grey_sliding(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Sliding mode with the predicted slip."""
    _, speed, slip, valid, _ = estimate
    s.since_s += dt_s
    if s.since_s >= k.interval_s:
        s.since_s = 0.0
        for i in range(_LENGTH - 1):
            s.slips[i] = s.slips[i + 1]
        s.slips[_LENGTH - 1] = slip
        s.predicted = predict(s.slips, k.steps)
    error = s.predicted - s.reference
    if valid and speed > k.hold_below:
        f, g = terms(k, slip, speed)
        s.torque = -(f + k.K * error / (abs(error) + k.delta)) / g
    return demand(duty_of(k, s.torque), s.torque, slip - s.reference, s.predicted)


class GreySliding(PublishedLaw, GreyState):
    """Grey sliding mode (Kayacan, Oniz and Kaynak 2009): a GM(1,1) predicts the slip for a sliding mode law."""

    gains = (
        Gain("K", 1.0, 0.0, 1000.0, "1/s", "switching rate"),
        Gain("delta", 0.05, 1e-4, 10.0, "1", "slip error at which half the rate is reached"),
        Gain("interval_s", 0.005, 0.0005, 0.1, "s", "between the slips of the grey model"),
        Gain("steps", 4.0, 0.1, 40.0, "1", "predicted ahead, in intervals"),
    )
    internals = (Quantity("slip_predicted", "1", "slip that the grey model predicts"),)
    function = staticmethod(grey_sliding)
