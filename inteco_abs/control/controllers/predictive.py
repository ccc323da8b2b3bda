"""Sliding mode control of a brake with dead time and lag, on an observer's prediction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final

from inteco_abs import elementary
from inteco_abs.control.controllers.base import Gain, Setup
from inteco_abs.control.estimators.prediction import NOT_A_SLIP, braking_slip
from inteco_abs.control.fall_back import FallBackState, fall_back
from inteco_abs.control.functions import Function
from inteco_abs.control.wheel_dynamics import WheelConstants, WheelDynamics, demanded_torque
from inteco_abs.quantities import Quantity
from inteco_abs.rig.brake_map import Points, inverse
from inteco_abs.rig.friction import formula
from inteco_abs.signals import BrakeDemand, Estimate

_START_RAD_S: Final = 180.0
_RISEN_SLIP: Final = 0.035
"""Slip from which the adhesion is nearly full; reaching demands the torque of at least this slip."""
_LEAST_HELD_NM: Final = 1.0
"""Torque below which the limit of the slip deceleration by a slow release falls no further."""
_LEAST_DECELERATION: Final = 1e-6
"""Slip deceleration in 1/s2 that any release leaves: without one, reaching has no slope."""


SWING_BAND: Final = "swing_band"
"""Gain by which the law falls back."""


@dataclass(frozen=True, slots=True)
class PredictiveConstants:
    """Gains and the rig."""

    hold_below: float
    """Road speed below which the last demand is held, rad/s."""
    contact: WheelConstants
    points: Points
    """The brake's map."""
    k: float
    a: float
    a_most: float
    kM: float
    release_share: float
    swing_band: float


@dataclass(slots=True)
class PredictiveState(FallBackState):
    """The last demand, and the torque in N m that the brake is driven to."""

    reference: float = 0.0
    """Slip to hold now."""
    brake: float = 0.0
    torque_nm: float = 0.0
    switching: float = 0.0
    excess_torque_nm: float = 0.0
    adhesion_factor: float = 0.0
    brake_dead_time_s: float = 0.0
    brake_lag_s: float = 0.0
    settled_nm: float = 0.0


def predictive(k: PredictiveConstants, s: PredictiveState, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Demand of the law; the last one without a prediction, and when the road is about to stop."""
    if _find_torques(k, s, estimate, dt_s):
        s.brake = inverse(k.points, s.settled_nm)
    return _newest(s)


def _newest(s: PredictiveState) -> BrakeDemand:
    known = s.excess_torque_nm, s.adhesion_factor, s.brake_dead_time_s, s.brake_lag_s
    return BrakeDemand(s.brake, s.torque_nm, s.switching, known)


def _find_torques(k: PredictiveConstants, s: PredictiveState, estimate: Estimate, dt_s: float) -> bool:
    """Find the torques that the law demands, and that the brake is driven to; False if the last ones are held."""
    seen = estimate.outlook
    if seen is None:
        return False
    x1, x2, lagged = seen.wheel_speed_rad_s, seen.road_speed_rad_s, seen.lagged_torque_nm
    if min(x2, estimate.road_speed_rad_s) <= k.hold_below:
        return False
    slip = braking_slip(x1, x2, k.contact.parameters)
    if not 0.0 <= slip <= 1.0:
        raise ValueError(NOT_A_SLIP)
    switching = slip - s.reference
    sine, cosine = elementary.sin_cos(seen.wheel_angle_rad)
    factor = seen.adhesion_factor + seen.ripple_cosine * cosine + seen.ripple_sine * sine
    factor_rate = (seen.ripple_sine * cosine - seen.ripple_cosine * sine) * x1
    mu = formula(k.contact.parameters, max(slip, _RISEN_SLIP))
    deceleration = min(k.a * _START_RAD_S / x2, k.a_most)
    if seen.brake_release_ratio > 1.0:
        deceleration /= seen.brake_release_ratio
    if k.release_share > 0.0 and seen.slowest_release_ratio > 1.0:
        held, by_held, _ = demanded_torque(k.contact, slip, 0.0, x1, x2, factor * mu)
        release_s = seen.brake_lag_s * seen.slowest_release_ratio
        most = k.release_share * max(held - seen.excess_torque_nm, _LEAST_HELD_NM) / (by_held * release_s)
        deceleration = min(deceleration, max(most, _LEAST_DECELERATION))
    share = _share(k, s, switching, dt_s)
    rate, slope = _approach(share * k.k, switching, deceleration)
    wanted, by_rate, by_adhesion = demanded_torque(k.contact, slip, -rate, x1, x2, factor * mu)
    wanted -= seen.excess_torque_nm
    slip_rate = -rate + (lagged - wanted) / by_rate
    wanted_rate = by_adhesion * mu * factor_rate - by_rate * slope * slip_rate
    torque_rate = share * k.kM * (wanted - lagged) + wanted_rate
    lag_s = seen.brake_lag_s if torque_rate >= 0.0 else seen.brake_lag_s * seen.brake_release_ratio
    s.settled_nm = lagged + lag_s * torque_rate
    s.torque_nm, s.switching, s.excess_torque_nm = wanted, switching, seen.excess_torque_nm
    s.adhesion_factor, s.brake_dead_time_s, s.brake_lag_s = (
        seen.adhesion_factor,
        seen.brake_dead_time_s,
        seen.brake_lag_s,
    )
    return True


def _share(k: PredictiveConstants, s: PredictiveState, switching: float, dt_s: float) -> float:
    """Share of the gains that is left: half for each time that the slip error has swung from one side to the other."""
    if k.swing_band == 0.0:
        return 1.0
    fall_back(s, k.swing_band, switching, s.reference, dt_s)
    return elementary.raised(0.5, s.steps) if s.steps > 0 else 1.0


def _approach(k: float, switching: float, a: float) -> tuple[float, float]:
    """Decay rate of the slip error, 1/s, and its derivative by the error; `k` in 1/s, the deceleration `a` in 1/s2."""
    error = abs(switching)
    if error * elementary.raised(k, 2) <= a:
        return k * switching, k
    rate = math.sqrt(2.0 * a * error - elementary.raised(a / k, 2))
    return math.copysign(rate, switching), a / rate


class PredictiveReaching(PredictiveState):
    """Reaching law on the slip predicted for the end of the dead time, with the brake's lag inverted.

    s' = -k*s near the surface; far from it s' = -sgn(s)*sqrt(2*a*(|s| - a/(2*k^2))), which is braking the slip at the
    deceleration a. Both meet in value and slope at |s| = a/k^2. As the torque moves the slip by 1/x2, a does too. The
    brake's lag tau adds an order: it is driven towards b = M + tau*(kM*(M* - M) + M*'), with M* the torque of the law
    in the observer's model, and M*' from the law's slope and the known ripple. Needs the observer.

    A brake that releases rho times slower than it rises takes the torque M off at most at M/(rho*tau), and the
    deceleration a asks for a*dM/ds', with the derivative of the model's torque by the slip's rate. So a is divided by
    the estimated rho, and at most `release_share` times M/(rho*tau*dM/ds') with the slowest rho that is likely. There
    is no such limit where the observer takes release and rise for equal.

    Where the model is wrong the slip swings about the reference. Each time that its error, which was beyond the
    `swing_band` on one side, is so on the other, k and kM fall to half, down to 1/32: the slower loop bears more dead
    time and lag that it does not know. Each 0.2 s without an error beyond the band take one of these steps back. A
    reference that moves is no swing.
    """

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(predictive)
    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("k", 60.0, 1.0, 1000.0, "1/s", "rate near the surface"),
        Gain("a", 34.0, 0.1, 10_000.0, "1/s2", "slip deceleration in reaching at 180 rad/s; grows as 1/x2"),
        Gain("a_most", 500.0, 0.1, 100_000.0, "1/s2", "limit of that growth"),
        Gain("kM", 400.0, 1.0, 10_000.0, "1/s", "rate at which the torque closes in on the law's"),
        Gain("release_share", 0.5, 0.0, 1.0, "1", "most of the deceleration by a release; 0: no limit"),
        Gain(
            SWING_BAND,
            0.03,
            0.0,
            1.0,
            "1",
            "slip error to both sides of which the slip swings; 0: no fall-back",
            fixed=True,
        ),
    )
    internals: ClassVar[tuple[Quantity, ...]] = (
        Quantity("excess_torque_nm", "N.m", "torque beyond the brake's static map, as estimated"),
        Quantity("adhesion_factor", "1", "adhesion over that of the nominal curve, as estimated"),
        Quantity("brake_dead_time_s", "s", "dead time of the brake, as estimated"),
        Quantity("brake_lag_s", "s", "lag of the rising brake, as estimated"),
    )
    estimator: ClassVar[str] = "observer"

    def __init__(
        self, setup: Setup, k: float, a: float, a_most: float, kM: float, release_share: float, swing_band: float
    ) -> None:
        super().__init__(reference=setup.reference_slip)
        contact, points = WheelDynamics(setup.parameters), setup.brake_map.points
        own = k, a, a_most, kM, release_share, swing_band
        self.k = PredictiveConstants(setup.hold_below_rad_s, contact, points, *own)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand of the law; the last one without a prediction, and when the road is about to stop."""
        if _find_torques(self.k, self, estimate, dt_s):
            self.brake = self.duty(self.settled_nm)
        return _newest(self)

    def duty(self, torque: float) -> float:
        """Duty at which the nominal brake settles to `torque` in N m."""
        return inverse(self.k.points, torque)
