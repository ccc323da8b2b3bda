"""Nonlinear model predictive control of the slip, solved in each tick.

D. Tavernini, F. Vacca, M. Metzler, D. Savitski, V. Ivanov, P. Gruber, A. E. Hartavi, M. Dhaens, A. Sorniotti: An
explicit nonlinear model predictive ABS controller for electro-hydraulic braking systems, IEEE Transactions on
Industrial Electronics 67 (5), 2020, 3990-4001; J. S. Esmaeili, A. Basci, A. Farnam: Design and verification of offline
robust model predictive controller for wheel slip control in ABS brakes, Machines 11 (8), 2023, article 803. The
solver: M. Diehl, H. G. Bock, J. P. Schloeder: A real-time iteration scheme for nonlinear optimization in optimal
feedback control, SIAM Journal on Control and Optimization 43 (5), 2005, 1714-1736.

The model is that of the rig, equation (10), with the brake's lag and dead time. From the slip at hand the law first
predicts over the dead time, under the torques that are on their way (as the first paper does against dead times), then
over the horizon under one torque, which it chooses for the least sum of squared slip errors plus a weight on its own
change, within 0 and the brake's full torque. For one bounded number the quadratic problem of a Gauss-Newton step is
solved by clipping; there is one step in each tick, from the torque of the tick before. The papers solve their problem
off-line instead, and store the law as a table.

A torque that the model misses is estimated from the slip that it predicted, and added: without it, what is predicted
would settle beside the reference.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from inteco_abs import elementary
from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand, duty_of, limited, terms
from inteco_abs.quantities import Quantity
from inteco_abs.rig import brake_torque
from inteco_abs.signals import BrakeDemand, Estimate

_STEPS = 6
"""Of the horizon."""
_AHEAD = 3
"""Steps over the dead time."""
_PENDING = 128
"""Torques on their way, one for each tick."""
_NUDGE_NM = 0.05
"""For the derivative of the prediction by the torque."""
_MOST_NM = 8.0
"""Of the torque that the model misses."""


@dataclass(slots=True)
class PredictiveState(PublishedState):
    pending: list[float] = field(default_factory=lambda: [0.0] * _PENDING)
    """A ring of torques in N m."""
    newest: int = 0
    torque: float = 0.0
    """The last solution, N m."""
    acting: float = 0.0
    """Of the brake, behind dead time and lag."""
    predicted: float = 0.0
    """Slip of this tick."""
    missed: float = 0.0
    """Torque that the model misses, N m."""
    speed: float = 0.0
    """Filtered, rad/s; for the road's deceleration."""
    started: bool = False


def _pending(s: Any, ticks: int) -> float:
    """The torque that was wanted so many ticks ago, at most _PENDING - 1."""
    torque: float = s.pending[(s.newest - ticks) % _PENDING]
    return torque


def _step(k: Any, slip: float, speed: float, torque: float, duration_s: float) -> float:
    """The slip after a time under a torque."""
    f, g = terms(k, slip, speed)
    return min(max(slip + (f + g * torque) * duration_s, 0.0), 1.0)


def model_predictive(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Predict, choose the torque, and keep it for the next predictions."""
    _, speed, slip, valid, _ = estimate
    if not s.started:
        s.predicted, s.speed, s.started = slip, speed, True
    deceleration = k.speed_rad_s * (s.speed - speed)
    s.speed -= deceleration * dt_s
    if valid and speed > k.hold_below:
        late = min(int(k.dead_time_s / dt_s), _PENDING - 1)
        _observe(k, s, slip, speed, _pending(s, late), dt_s)
        slip_then, speed_then, acting = _after_dead_time(k, s, slip, speed, deceleration, late)
        s.torque = _solve(k, s, slip_then, speed_then, acting, deceleration)
    s.newest = (s.newest + 1) % _PENDING
    s.pending[s.newest] = s.torque
    return demand(duty_of(k, s.torque), s.torque, slip - s.reference, s.missed)


def _observe(k: Any, s: Any, slip: float, speed: float, arriving: float, dt_s: float) -> None:
    """Learn what the model misses from the slip of the last prediction, and predict that of the next tick."""
    f, g = terms(k, slip, speed)
    w, off = k.observer_rad_s, slip - s.predicted
    s.missed = limited(s.missed + w * w * off / g * dt_s, _MOST_NM)
    s.predicted += (f + g * (s.acting + s.missed) + 2.0 * w * off) * dt_s
    s.acting += (arriving - s.acting) * (1.0 - elementary.exp(-dt_s / k.lag_s))


def _after_dead_time(
    k: Any, s: Any, slip: float, speed: float, deceleration: float, late: int
) -> tuple[float, float, float]:
    """Slip, road speed and torque when a torque that is wanted now arrives."""
    duration_s = k.dead_time_s / _AHEAD
    share, acting = 1.0 - elementary.exp(-duration_s / k.lag_s), s.acting
    for i in range(_AHEAD):
        before = acting
        acting += (_pending(s, late * (2 * (_AHEAD - i) - 1) // (2 * _AHEAD)) - acting) * share
        slip = _step(k, slip, speed, 0.5 * (before + acting) + s.missed, duration_s)
        speed -= deceleration * duration_s
    return slip, speed, acting


def _solve(k: Any, s: Any, slip: float, speed: float, acting: float, deceleration: float) -> float:
    """A Gauss-Newton step of the torque from the last solution."""
    duration_s = k.horizon_s / _STEPS
    share = 1.0 - elementary.exp(-duration_s / k.lag_s)
    other, other_acting = slip, acting
    slope_error, slopes = 0.0, k.rho
    for _ in range(_STEPS):
        before, other_before = acting, other_acting
        acting += (s.torque - acting) * share
        other_acting += (s.torque + _NUDGE_NM - other_acting) * share
        slip = _step(k, slip, speed, 0.5 * (before + acting) + s.missed, duration_s)
        other = _step(k, other, speed, 0.5 * (other_before + other_acting) + s.missed, duration_s)
        speed -= deceleration * duration_s
        slope = (other - slip) / _NUDGE_NM
        slope_error += slope * (slip - s.reference)
        slopes += slope * slope
    found: float = min(max(s.torque - slope_error / slopes, 0.0), brake_torque(1.0, k.model.parameters))
    return found


class ModelPredictive(PublishedLaw, PredictiveState):
    """Nonlinear model predictive control (Tavernini and others 2020), with a Gauss-Newton step in each tick."""

    gains = (
        Gain("horizon_s", 0.05, 0.005, 0.5, "s", "predicted beyond the dead time"),
        Gain("rho", 1e-4, 1e-9, 1.0, "N-2.m-2", "weight of the torque's change in a tick"),
        Gain("lag_s", 0.05, 0.002, 0.2, "s", "lag of the brake"),
        Gain("dead_time_s", 0.015, 0.0005, 0.06, "s", "dead time of the brake"),
        Gain("observer_rad_s", 30.0, 1.0, 500.0, "rad/s", "of the estimate of what the model misses"),
        Gain("speed_rad_s", 50.0, 1.0, 500.0, "rad/s", "of the filter for the road's deceleration"),
    )
    internals = (Quantity("missed_nm", "N.m", "torque that the model misses"),)
    function = staticmethod(model_predictive)
