"""Extremum seeking: the slip at which the road slows most.

S. Drakunov, U. Ozguner, P. Dix, B. Ashrafi: ABS control using optimum search via sliding modes, IEEE Transactions on
Control Systems Technology 3 (1), 1995, 79-85; E. Dincmen, B. Aksun Guvenc, T. Acarman: Extremum-seeking control of
ABS braking in road vehicles with lateral force improvement, IEEE Transactions on Control Systems Technology 22 (1),
2014, 230-237.

Here in the form with a sine: it sways the slip reference of a PI controller, and the road's deceleration, times the
same sine, is the gradient that the reference climbs. It needs no reference; that of the configuration is its start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inteco_abs import elementary
from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_SLOW = 0.2
"""Ratio of the filter that removes the mean to the sway's frequency."""
_LOW, _HIGH = 0.02, 0.9


@dataclass(slots=True)
class SeekingState(PublishedState):
    phase: float = 0.0
    speed: float = 0.0
    deceleration: float = 0.0
    mean: float = 0.0
    moved: float = 0.0
    """Of the reference from its start."""
    integral: float = 0.0
    started: bool = False


def extremum_seeking(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """A PI controller whose reference climbs the deceleration."""
    _, speed, slip, _, _ = estimate
    if not s.started:
        s.speed, s.started = speed, True
    w = k.sway_rad_s
    s.phase += w * dt_s
    sine, _ = elementary.sin_cos(s.phase)
    s.deceleration = 3.0 * w * (s.speed - speed)  # a filtered derivative
    s.speed += 3.0 * w * (speed - s.speed) * dt_s
    s.mean += _SLOW * w * (s.deceleration - s.mean) * dt_s
    s.moved += k.climb * (s.deceleration - s.mean) * sine * dt_s
    s.moved = min(max(s.moved, _LOW - s.reference), _HIGH - s.reference)
    sought = s.reference + s.moved
    error = sought + k.sway * sine - slip
    duty = k.bias + k.Kp * error + s.integral
    if 0.0 < duty < 1.0 or (duty >= 1.0) != (error > 0.0):
        s.integral += k.Ki * error * dt_s
    return demand(duty, 0.0, slip - s.reference, sought)


class ExtremumSeeking(PublishedLaw, SeekingState):
    """Extremum seeking (Drakunov and others 1995, Dincmen and others 2014): it climbs the road's deceleration."""

    gains = (
        Gain("sway", 0.01, 0.0, 0.2, "1", "amplitude of the reference's sway"),
        Gain("sway_rad_s", 40.0, 1.0, 500.0, "rad/s", "frequency of the sway"),
        Gain("climb", 0.001, 0.0, 10.0, "s/rad", "climbing rate of the reference, per deceleration"),
        Gain("Kp", 0.45, 0.0, 100.0, "1", "proportional gain"),
        Gain("Ki", 1.3, 0.0, 1000.0, "1/s", "integral gain"),
        Gain("bias", 0.57, 0.0, 1.0, "1", "duty at no error"),
    )
    internals = (Quantity("slip_sought", "1", "reference without the sway"),)
    function = staticmethod(extremum_seeking)
