"""Extended Kalman filter of a braking rig: wheels, brake and contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from inteco_abs.control.estimators.eccentricity import EccentricityFilter
from inteco_abs.control.estimators.prediction import LONGEST_DEAD_TIME_S, DelayLine, braking_slip, outlook
from inteco_abs.control.wheel_dynamics import WheelDynamics
from inteco_abs.rig import BrakeMap, RigParameters, adhesion, adhesion_slope
from inteco_abs.signals import Prediction

_LONGEST_STEP_S: Final = 0.001
"""Of the explicit integration; longer steps would oscillate at little slip."""
_DEAD_TIME_S: Final = (0.002, LONGEST_DEAD_TIME_S)
_LAG_S: Final = (0.025, 0.090)
"""Ranges to which both estimates are clamped."""
_WALK_AT_RAD_S: Final = 100.0
_UNSETTLED: Final = 0.5
"""Standard deviation of the brake's torque at the start, as a share of the torque commanded last."""
_LOST_RAD: Final = 0.5
"""Innovation of a wheel's angle beyond which the filter has diverged."""
_STEP_PAUSE_S: Final = 0.010
"""Shortest time between two steps of the adhesion."""
Vector = list[float]


class EkfTuning(NamedTuple):
    """Tuning as standard deviations: of the rig from the published one, and of its changes in 1 s.

    From drawn rigs (`tools/tune_predictive`), of seeds that no test uses.
    """

    dead_time_s: float = 0.010
    """Prior means of the brake's dead time and lag."""
    lag_s: float = 0.050
    dead_time_sd_s: float = 0.0079
    lag_sd_s: float = 0.0063
    adhesion_sd: float = 0.073
    """Of the factor on equation (8)."""
    adhesion_walk: float = 0.2
    """Of its change in 1 s at 100 rad/s; proportional to the speed, as a road changes with distance."""
    ripple_sd: float = 0.0095
    """Of each component of its ripple over a turn of the wheel."""
    torque_sd_nm: float = 0.34
    """Of the excess torque: the brake's torque beyond its map."""
    torque_walk_nm: float = 0.21
    torque_per_swing: float = 0.018
    """Added to that while the torque changes: per s^0.5 and N m/s."""
    lag_torque_walk_nm: float = 0.031
    """Of the lagged torque."""
    lag_torque_per_swing: float = 0.0015
    wheel_walk_rad_s: float = 0.54
    """Of the speeds, by what is not modelled."""
    road_walk_rad_s: float = 0.17
    count_noise: float = 1.4
    """Of a reading, in counts; above that of quantisation and jitter, which keeps the torque estimate calm."""
    step_after_s: float = 0.2
    """Time in braking before which no step of the adhesion is assumed: learning the brake looks the same."""
    step_adhesion: float = 0.06
    """Of the adhesion factor in a step."""
    step_delay_s: float = 0.0067
    """Time between a step and its detection."""
    surprise: float = 0.4
    """Threshold of detection: mean of the wheel's innovations, each over its standard deviation."""
    surprise_gain: float = 0.15
    """Weight of a new innovation in that mean."""


class BrakingEkf:
    """An extended Kalman filter.

    States: angle and speed of wheel and road; lagged brake torque; excess torque; factor on the adhesion of (8) and
    its ripple, cosine and sine in the wheel's angle; dead time and lag of the brake.

    The torque follows M+ = b + (M - b)*exp(-T/tau), with b the map's torque of the command a dead time ago. A changing
    torque, as in reaching, makes dead time and lag observable; the road's deceleration the adhesion, the wheel's the
    torque.
    """

    __slots__ = (
        *("_P", "_x", "_pending", "_by_factor", "_surprise", "_step_in_s"),
        *("_brake_map", "_contact", "_noise", "_parameters", "_ratio", "_spread"),
    )

    def __init__(
        self, parameters: RigParameters, brake_map: BrakeMap, spread: EkfTuning, count_rad: float, period_s: float
    ) -> None:
        self._brake_map = brake_map
        self._parameters = parameters
        self._contact = WheelDynamics(parameters)
        self._ratio = parameters.r1 / parameters.r2
        self._spread = spread
        self._noise = (spread.count_noise * count_rad) ** 2
        self._pending = DelayLine(period_s)
        self._x: Vector = []
        self._P: list[Vector] = []
        self._by_factor = 0.0, 0.0  # accelerations per adhesion factor
        self._surprise = 0.0
        self._step_in_s = 0.0  # until a step may show

    def tell(self, duty: float, ticks: int) -> None:
        """Record the duty in force from the current sample on, which is `ticks` ticks after the last one."""
        self._pending.tell(self._brake_map.torque(duty), ticks)

    def begin(self, wheel: EccentricityFilter, road: EccentricityFilter) -> None:
        """Start from two rolling wheels, or again in the middle of braking, with the brake's last command."""
        spread, told = self._spread, self._pending.newest
        self._x = [wheel.angle, wheel.speed, road.angle, road.speed, told, 0.0, 1.0, 0.0, 0.0]
        self._x += [spread.dead_time_s, spread.lag_s]
        self._P = [[0.0] * 11 for _ in range(11)]
        for i, disc in ((0, wheel), (2, road)):
            angle, speed, both = disc.spread
            self._P[i][i], self._P[i + 1][i + 1] = angle, speed + spread.road_walk_rad_s**2
            self._P[i][i + 1] = self._P[i + 1][i] = both
        self._P[4][4] = (_UNSETTLED * told) ** 2
        deviations = (spread.torque_sd_nm, spread.adhesion_sd, spread.ripple_sd, spread.ripple_sd)
        for i, deviation in enumerate((*deviations, spread.dead_time_sd_s, spread.lag_sd_s), 5):
            self._P[i][i] = deviation**2
        self._surprise, self._step_in_s = 0.0, spread.step_after_s

    @property
    def speeds(self) -> tuple[float, float]:
        """Speeds of wheel and road, rad/s."""
        return self._x[1], self._x[3]

    def update(self, wheel_angle: float, road_angle: float, dt_s: float, ticks: int) -> bool:
        """Advance by `dt_s`, which is `ticks` ticks, and correct by the measured angles in rad.

        False if the filter has diverged from them: its state is no longer valid then.
        """
        steps = max(ticks, math.ceil(dt_s / _LONGEST_STEP_S - 1e-6))
        for left in range(steps - 1, -1, -1):
            self._predict(dt_s / steps, left * ticks // steps)
        if not self._correct(wheel_angle, road_angle):
            return False
        self._step_in_s -= dt_s
        if self._step_in_s <= 0.0 and abs(self._surprise) > self._spread.surprise:
            self._allow_step()
        x = self._x
        x[9] = min(max(x[9], _DEAD_TIME_S[0]), _DEAD_TIME_S[1])
        x[10] = min(max(x[10], _LAG_S[0]), _LAG_S[1])
        return True

    def outlook(self) -> Prediction:
        """Prediction for the instant at which the next command reaches the brake."""
        return outlook(self._contact, self._parameters, self._pending, self._x)

    def _predict(self, T: float, ago: int) -> None:
        th1, x1, th2, x2, M, d, factor, cosine, sine, dead_time, lag = self._x
        k, spread = self._parameters, self._spread
        settled, later = self._pending.arrived(dead_time, ago)
        left = math.exp(-T / lag)
        slip = braking_slip(x1, x2, k)
        turned, turned_sine = math.cos(th1), math.sin(th1)
        mu = adhesion(slip, k)
        scale = factor + cosine * turned + sine * turned_sine
        moving = self._contact.accelerations(x1, x2, settled + (M - settled) * 0.5 * (1.0 + left) + d, scale * mu)
        a1, a2, wheel_by_mu, road_by_mu, wheel_by_nm, road_by_nm = moving
        x2_safe = max(x2, 1.0)
        steepness = scale * adhesion_slope(slip, k) / x2_safe
        by_x1, by_x2 = -steepness * self._ratio, steepness * (1.0 - slip)
        by_dead_time = (1.0 - left) * later
        by_lag = (M - settled) * left * T / lag**2
        rolling = 1.0 - T * k.d2 / k.J2

        def carried(row: Sequence[float]) -> Vector:
            """The transition's Jacobian times a vector of states."""
            e_th1, e1, e_th2, e2, e_M, e_d, e_factor, e_cosine, e_sine, e_dead, e_lag = row
            e_mu = mu * (e_factor + turned * e_cosine + turned_sine * e_sine) + by_x1 * e1 + by_x2 * e2
            e_torque = e_M + e_d + k.d1 * e1
            return [
                e_th1 + T * e1,
                e1 + T * (wheel_by_mu * e_mu + wheel_by_nm * e_torque),
                e_th2 + T * e2,
                rolling * e2 + T * (road_by_mu * e_mu + road_by_nm * e_torque),
                left * e_M + by_dead_time * e_dead + by_lag * e_lag,
                *row[5:],
            ]

        self._by_factor = wheel_by_mu * mu, road_by_mu * mu
        half = 0.5 * T * T
        self._x[:5] = [
            th1 + T * x1 + half * a1,
            x1 + T * a1,
            th2 + T * x2 + half * a2,
            x2 + T * a2,
            settled + (M - settled) * left,
        ]
        rows = [carried(row) for row in self._P]
        P = [carried(column) for column in list(zip(*rows, strict=True))[:5]] + rows[5:]
        swing = (settled - M) / lag
        P[1][1] += T * spread.wheel_walk_rad_s**2
        P[3][3] += T * spread.road_walk_rad_s**2
        P[4][4] += T * (spread.lag_torque_walk_nm**2 + (spread.lag_torque_per_swing * swing) ** 2)
        P[5][5] += T * (spread.torque_walk_nm**2 + (spread.torque_per_swing * swing) ** 2)
        P[6][6] += T * (spread.adhesion_walk * x2 / _WALK_AT_RAD_S) ** 2
        self._P = P

    def _correct(self, wheel_angle: float, road_angle: float) -> bool:
        """Sequential correction by both angles: the second uses the covariance that the first leaves."""
        P, x = self._P, self._x
        wheel, road = P[0], P[2]
        if not (abs(wheel_angle - x[0]) < _LOST_RAD and abs(road_angle - x[2]) < _LOST_RAD):
            return False  # also catches NaN
        wheel_scale = 1.0 / (wheel[0] + self._noise)
        first = [w * wheel_scale for w in wheel]
        road = [r - first[2] * w for r, w in zip(road, wheel, strict=True)]
        road_scale = 1.0 / (road[2] + self._noise)
        second = [r * road_scale for r in road]
        wheel_error = wheel_angle - x[0]
        self._surprise += self._spread.surprise_gain * (wheel_error * math.sqrt(wheel_scale) - self._surprise)
        road_error = road_angle - x[2] - first[2] * wheel_error
        self._x = [v + a * wheel_error + b * road_error for v, a, b in zip(x, first, second, strict=True)]
        self._P = [
            [p - a * w - b * r for p, w, r in zip(row, wheel, road, strict=True)]
            for row, a, b in zip(P, first, second, strict=True)
        ]
        return True

    def _allow_step(self) -> None:
        """Add the covariance of a step of the adhesion `step_delay_s` ago, and of its effect on the wheels since."""
        ago, (wheel, road) = self._spread.step_delay_s, self._by_factor
        moved = [0.5 * ago * ago * wheel, ago * wheel, 0.5 * ago * ago * road, ago * road, 0.0, 0.0, 1.0]
        moved = [self._spread.step_adhesion * each for each in moved] + [0.0] * 4
        self._P = [[p + a * b for p, b in zip(row, moved, strict=True)] for row, a in zip(self._P, moved, strict=True)]
        self._surprise, self._step_in_s = 0.0, _STEP_PAUSE_S
