"""Sliding mode control of a brake with dead time and lag, on an observer's prediction."""

from __future__ import annotations

import math
from typing import ClassVar, Final

from inteco_abs.control.controllers.base import Gain, Setup
from inteco_abs.control.estimators.prediction import braking_slip
from inteco_abs.control.wheel_dynamics import WheelDynamics
from inteco_abs.rig import adhesion
from inteco_abs.signals import BrakeDemand, Estimate, Prediction

_START_RAD_S: Final = 180.0
_RISEN_SLIP: Final = 0.035
"""Slip from which the adhesion is nearly full; reaching demands the torque of at least this slip."""


class PredictiveReaching:
    """Reaching law on the slip predicted for the end of the dead time, with the brake's lag inverted.

    s' = -k*s near the surface; far from it s' = -sgn(s)*sqrt(2*a*(|s| - a/(2*k^2))), which is braking the slip at the
    deceleration a. Both meet in value and slope at |s| = a/k^2. As the torque moves the slip by 1/x2, a does too. The
    brake's lag tau adds an order: it is driven towards b = M + tau*(kM*(M* - M) + M*'), with M* the torque of the law
    in the observer's model, and M*' from the law's slope and the known ripple. Needs the observer.
    """

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("k", 60.0, 1.0, 1000.0, "1/s", "rate near the surface"),
        Gain("a", 34.0, 0.1, 10_000.0, "1/s2", "slip deceleration in reaching at 180 rad/s; grows as 1/x2"),
        Gain("a_most", 500.0, 0.1, 100_000.0, "1/s2", "limit of that growth"),
        Gain("kM", 400.0, 1.0, 10_000.0, "1/s", "rate at which the torque closes in on the law's"),
    )
    internals: ClassVar[tuple[str, ...]] = (
        "excess_torque_nm",
        "adhesion_factor",
        "brake_dead_time_s",
        "brake_lag_s",
    )
    estimator: ClassVar[str] = "observer"

    def __init__(self, setup: Setup, k: float, a: float, a_most: float, kM: float) -> None:
        self._reference = setup.reference_slip
        self._hold_below = setup.hold_below_rad_s
        self._parameters = setup.parameters
        self._brake_map = setup.brake_map
        self._contact = WheelDynamics(setup.parameters)
        self._k = k
        self._a = a
        self._a_most = a_most
        self._kM = kM
        self._last = BrakeDemand(0.0)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:  # noqa: ARG002  a static law
        """Demand of the law; the last one without a prediction, and when the road is about to stop."""
        seen = estimate.outlook
        if seen is None or min(seen.road_speed_rad_s, estimate.road_speed_rad_s) <= self._hold_below:
            return self._last
        slip = braking_slip(seen.wheel_speed_rad_s, seen.road_speed_rad_s, self._parameters)
        switching = slip - self._reference
        wanted, settled = self._torques(seen, slip, switching)
        known = (seen.excess_torque_nm, seen.adhesion_factor, seen.brake_dead_time_s, seen.brake_lag_s)
        self._last = BrakeDemand(self.duty(settled), wanted, switching, known)
        return self._last

    def duty(self, torque: float) -> float:
        """Duty at which the nominal brake settles to `torque` in N m."""
        return self._brake_map.duty(torque)

    def _torques(self, seen: Prediction, slip: float, switching: float) -> tuple[float, float]:
        """Brake torque that the law demands, and the settled torque that the brake is driven to, in N m."""
        x1, x2, lagged = seen.wheel_speed_rad_s, seen.road_speed_rad_s, seen.lagged_torque_nm
        cosine, sine = math.cos(seen.wheel_angle_rad), math.sin(seen.wheel_angle_rad)
        factor = seen.adhesion_factor + seen.ripple_cosine * cosine + seen.ripple_sine * sine
        factor_rate = (seen.ripple_sine * cosine - seen.ripple_cosine * sine) * x1
        mu = adhesion(max(slip, _RISEN_SLIP), self._parameters)
        rate, slope = self._approach(switching, x2)
        wanted, by_rate, by_adhesion = self._contact.torque(slip, -rate, x1, x2, factor * mu)
        wanted -= seen.excess_torque_nm
        slip_rate = -rate + (lagged - wanted) / by_rate
        wanted_rate = by_adhesion * mu * factor_rate - by_rate * slope * slip_rate
        return wanted, lagged + seen.brake_lag_s * (self._kM * (wanted - lagged) + wanted_rate)

    def _approach(self, switching: float, road_speed: float) -> tuple[float, float]:
        """Decay rate of the slip error, 1/s, and its derivative by the error."""
        a, error = min(self._a * _START_RAD_S / road_speed, self._a_most), abs(switching)
        if error * self._k**2 <= a:
            return self._k * switching, self._k
        rate = math.sqrt(2.0 * a * error - (a / self._k) ** 2)
        return math.copysign(rate, switching), a / rate
