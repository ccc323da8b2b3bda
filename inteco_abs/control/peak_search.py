"""Search of the slip at which the road slows most: a curve is fitted to deceleration and slip, and its peak is held.

Adhesion over slip is taken as a*(1 - exp(-c*slip)) - b*slip, Burckhardt's form, with one fixed c: then it is linear in
a and b, and least squares with forgetting find both from the road wheel's deceleration. So do M. Tanelli, L. Piroddi,
S. M. Savaresi: Real-time identification of tire-road friction conditions, IET Control Theory and Applications 3 (7),
2009, 891-906, and R. de Castro, R. E. Araujo, J. S. Cardoso, D. Freitas: A new linear parametrization for peak friction
coefficient estimation in real time, Proc. IEEE Vehicle Power and Propulsion Conference, Lille 2010 (both cited from
memory). The peak is at ln(c*a/b)/c. A small sine on the slip keeps telling which way it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from inteco_abs import elementary

_C: Final = 20.0
"""Of the curve. The roads of Burckhardt have 24 to 94; what is fitted is the curve near the slip held."""
_FILTER_RAD_S: Final = 80.0
"""Of the derivative of the speed, and of the regressors, which then are late by as much."""
_MEMORY_S: Final = 0.15
"""Time after which a sample counts 1/e."""
_SWAY: Final = 0.02
"""Amplitude of the sine."""
_SWAY_RAD_S: Final = 14.0
_FAITH: Final = 2e-5
"""Weight of a peak at the slip sought so far, against the sum of squares of the regressors over the memory."""
_MOST_PER_S: Final = 2.0
"""Rate of the slip sought."""
_LOW: Final = 0.04
_HIGH: Final = 0.5
"""Slips sought, without the sine: beyond, a wheel locks too easily."""


@dataclass(slots=True)
class PeakState:
    """Sums over the samples, each weighted by its age, and the slip sought."""

    sought: float
    speed: float = 0.0
    """Filtered, rad/s."""
    rise: float = 0.0
    """Of the curve without its fall, filtered."""
    slip: float = 0.0
    """Filtered."""
    rise_rise: float = 0.0
    rise_slip: float = 0.0
    slip_slip: float = 0.0
    rate_rise: float = 0.0
    rate_slip: float = 0.0
    started: bool = False


def seek_peak(s: PeakState, elapsed_s: float, speed: float, slip: float, dt_s: float) -> float:
    """Slip to hold now: that of the peak found so far, with the sine; `speed` is that of the road in rad/s."""
    if not s.started:
        s.speed, s.started = speed, True
    _learn(s, speed, slip, dt_s)
    step = _MOST_PER_S * dt_s
    s.sought += min(max(_peak(s) - s.sought, -step), step)
    return s.sought + _SWAY * elementary.sin(_SWAY_RAD_S * elapsed_s)


def _learn(s: PeakState, speed: float, slip: float, dt_s: float) -> None:
    """Filter, and add the sample to the sums."""
    share, fresh = _FILTER_RAD_S * dt_s, dt_s / _MEMORY_S
    rate = _FILTER_RAD_S * (s.speed - speed)
    s.speed -= rate * dt_s
    s.rise += share * (1.0 - elementary.exp(-_C * slip) - s.rise)
    s.slip += share * (slip - s.slip)
    s.rise_rise += fresh * (s.rise * s.rise - s.rise_rise)
    s.rise_slip += fresh * (s.rise * s.slip - s.rise_slip)
    s.slip_slip += fresh * (s.slip * s.slip - s.slip_slip)
    s.rate_rise += fresh * (rate * s.rise - s.rate_rise)
    s.rate_slip += fresh * (rate * s.slip - s.rate_slip)


def _peak(s: PeakState) -> float:
    """Slip of the fitted curve's peak."""
    near = _C * elementary.exp(-_C * s.sought)  # b/a with the peak where it is sought
    a11, a12, a22 = s.rise_rise + _FAITH * near * near, s.rise_slip + _FAITH * near, s.slip_slip + _FAITH
    determinant = a11 * a22 - a12 * a12
    if not determinant > 0.0:
        return s.sought
    a = (a22 * s.rate_rise - a12 * s.rate_slip) / determinant
    b = (a12 * s.rate_rise - a11 * s.rate_slip) / determinant
    if not a > 0.0:
        return _LOW
    ratio = b / (_C * a)
    if ratio <= elementary.exp(-_C * _HIGH):
        return _HIGH
    return max(-elementary.log(ratio) / _C, _LOW)
