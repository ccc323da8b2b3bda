"""Extended Kalman filter of a braking rig: wheels, brake and contact."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from inteco_abs import elementary
from inteco_abs.control.estimators.eccentricity import DiscState
from inteco_abs.control.estimators.prediction import (
    NOT_A_SLIP,
    DelayConstants,
    DelayState,
    arrived,
    braking_slip,
)
from inteco_abs.control.wheel_dynamics import WheelConstants, accelerations
from inteco_abs.rig.friction import formula, formula_slope

_LONGEST_STEP_S: Final = 0.001
"""Longest step of the explicit integration; longer ones would oscillate at little slip."""
SHORTEST_DEAD_TIME_S: Final = 0.002
_LEAST_RELEASE: Final = 0.3
_MOST_RELEASE: Final = 4.0
"""Of the lag in releasing over the one in rising."""
_WALK_AT_RAD_S: Final = 100.0
_UNSETTLED: Final = 0.5
"""Standard deviation of the brake's torque at the start, as a share of the torque commanded last."""
_LOST_RAD: Final = 0.5
"""Innovation of a wheel's angle beyond which the filter has diverged."""
_CALM_S: Final = 0.1
"""Time after a step of the adhesion, or after that in which none is assumed, from which on the fade is learnt."""
_LEAST_LOSS: Final = 100.0
"""Loss of torque by a fade of 1/J, in N m/s, below which none is learnt: 1 N m at 100 rad/s."""
_MOST_FADE: Final = 0.002
"""1/J; the whole torque would be gone after 500 J, and a stop has some 400."""
_STEP_PAUSE_S: Final = 0.010
"""Shortest time between two steps of the adhesion."""
MISLED_SD: Final = (0.03, 5.0, 0.03, 1.0)
"""Standard deviations of angles and speeds of wheel and road, rad and rad/s, after the filter was misled."""
Row = list[float]
Tuple5 = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class EkfTuning:
    """Tuning as standard deviations: of the rig from the published one, and of its changes in 1 s.

    From drawn rigs (`tools/tune_predictive`), of seeds that no test uses.
    """

    dead_time_s: float = 0.010
    """Prior means of the brake's dead time and lag."""
    lag_s: float = 0.050
    dead_time_sd_s: float = 0.0079
    lag_sd_s: float = 0.0063
    adhesion_sd: float = 0.073
    """Deviation of the adhesion's factor, which multiplies equation (8)."""
    adhesion_walk: float = 0.2
    """Deviation of that factor's change in 1 s at 100 rad/s; proportional to speed: a road changes with distance."""
    ripple_sd: float = 0.0095
    """Deviation of each component of that factor's ripple over a turn of the wheel."""
    torque_sd_nm: float = 0.34
    """Deviation of the excess torque: the brake's torque beyond its map."""
    torque_walk_nm: float = 0.21
    torque_per_swing: float = 0.018
    """Added to that while the torque changes: per s^0.5 and N m/s."""
    lag_torque_walk_nm: float = 0.031
    """Deviation of the lagged torque's change in 1 s."""
    lag_torque_per_swing: float = 0.0015
    wheel_walk_rad_s: float = 0.54
    """Deviation of the speeds' change in 1 s, by what is not modelled."""
    road_walk_rad_s: float = 0.17
    count_noise: float = 1.4
    """Deviation of a reading, in counts; above that of quantisation and jitter: the torque estimate stays calm."""
    step_after_s: float = 0.2
    """Time in braking before which no step of the adhesion is assumed: learning the brake looks the same."""
    step_adhesion: float = 0.06
    """Deviation of the adhesion factor's change in a step."""
    step_delay_s: float = 0.0067
    """Time between a step and its detection."""
    surprise: float = 0.4
    """Threshold of detection: mean of the wheel's innovations, each over its standard deviation."""
    surprise_gain: float = 0.15
    """Weight of a new innovation in that mean."""
    longest_dead_time_s: float = 0.030
    """The estimate is clamped to 2 ms and this, and the lag's to the next two."""
    shortest_lag_s: float = 0.025
    longest_lag_s: float = 0.090
    release_ratio: float = 1.0
    """Prior mean of the lag in releasing over the one in rising."""
    release_sd: float = 0.0
    latch_jitter_s: float = 0.0
    """Deviation of the time between stamp and counts, common to both wheels."""
    learns_radius: bool = False
    """Whether the ratio of the radii is learnt in the run-up."""
    finds_onset: bool = False
    """Whether dead time and lag far from the prior ones are found by how the wheel departs from rolling."""
    fade_gain: float = 0.0
    """Rate at which what corrects the excess torque passes for the brake's fade, 1/s; 0: it is not learnt."""
    learns_second: bool = False
    """Whether the discs' errors twice per turn are learnt there."""


@dataclass(frozen=True, slots=True)
class EkfConstants:
    """The rig, and the tuning."""

    contact: WheelConstants
    delay: DelayConstants
    tuning: EkfTuning
    ratio: float
    """r1/r2"""
    noise: float
    """Variance of a reading's angle, rad2."""
    jitter: float
    """Variance of the time between stamp and counts, s2."""


@dataclass(slots=True)
class EkfState:
    """State of an extended Kalman filter.

    States: angle and speed of wheel and road; lagged brake torque; excess torque; factor on the adhesion of (8) and
    its ripple, cosine and sine in the wheel's angle; dead time and lag of the brake, and the lag's factor in releasing.

    The torque follows M+ = b + (M - b)*exp(-T/tau), with b the map's torque of the command a dead time ago. A changing
    torque, as in reaching, makes dead time and lag observable; the road's deceleration the adhesion, the wheel's the
    torque.
    """

    x: Row = field(default_factory=lambda: [0.0] * 12)
    P: list[Row] = field(default_factory=lambda: [[0.0] * 12 for _ in range(12)])
    """Covariances of the states."""
    wheel_by_factor: float = 0.0
    """Acceleration per adhesion factor."""
    road_by_factor: float = 0.0
    surprise: float = 0.0
    step_in_s: float = 0.0
    """Until a step of the adhesion may show."""
    fade: float = 0.0
    """Share of its torque that the brake loses by each joule in it, 1/J. The excess torque falls by that, and follows
    without lag; this one follows its corrections, as the integral part of an observer does."""
    radius_ratio: float = 1.0
    """Ratio of the radii r1/r2 over the published one. The wheel's angle and speed in the state are this times the real
    ones, so that the published radii hold for them."""


def begin(k: EkfConstants, s: EkfState, pending: DelayState, wheel: DiscState, road: DiscState) -> None:
    """Start from two rolling wheels, or again in the middle of braking, with the brake's last command."""
    x, P, newest_nm, sd = s.x, s.P, pending.torques[pending.newest], k.tuning
    for i in range(12):
        x[i] = 0.0
        for j in range(12):
            P[i][j] = 0.0
    ratio = s.radius_ratio
    x[0], x[1], x[2], x[3], x[4] = wheel.angle * ratio, wheel.speed * ratio, road.angle, road.speed, newest_nm
    x[6], x[9], x[10], x[11] = 1.0, sd.dead_time_s, sd.lag_s, sd.release_ratio
    for i, disc in ((0, wheel), (2, road)):
        P[i][i], P[i + 1][i + 1] = disc.P[0][0], disc.P[1][1] + elementary.raised(sd.road_walk_rad_s, 2)
        P[i][i + 1] = P[i + 1][i] = disc.P[0][1]
    P[4][4] = elementary.raised(_UNSETTLED * newest_nm, 2)
    deviations = sd.torque_sd_nm, sd.adhesion_sd, sd.ripple_sd, sd.ripple_sd, sd.dead_time_sd_s, sd.lag_sd_s
    P[11][11] = elementary.raised(sd.release_sd, 2)
    for i in range(6):
        P[5 + i][5 + i] = elementary.raised(deviations[i], 2)
    s.surprise, s.step_in_s, s.fade = 0.0, sd.step_after_s, 0.0


def _restart_covariance(k: EkfConstants, s: EkfState) -> None:
    """Forget the covariance, and keep the state: deviations as before braking, and of the wheels as if misled."""
    P, sd, torque = s.P, k.tuning, _UNSETTLED * s.x[4]
    for i in range(12):
        for j in range(12):
            P[i][j] = 0.0
    for i in range(4):
        P[i][i] = elementary.raised(MISLED_SD[i], 2)
    deviations = torque, sd.torque_sd_nm, sd.adhesion_sd, sd.ripple_sd, sd.ripple_sd, sd.dead_time_sd_s, sd.lag_sd_s
    for i in range(7):
        P[4 + i][4 + i] = elementary.raised(deviations[i], 2)
    P[11][11] = elementary.raised(sd.release_sd, 2)


def braking_ekf(
    k: EkfConstants, s: EkfState, pending: DelayState, wheel_angle: float, road_angle: float, dt_s: float, ticks: int
) -> bool:
    """Advance by `dt_s`, which is `ticks` ticks, and correct by the measured angles in rad.

    False if the filter has diverged from them: its state is no longer valid then.
    """
    steps = max(ticks, math.ceil(dt_s / _LONGEST_STEP_S - 1e-6))
    for left in range(steps - 1, -1, -1):
        predict(k, s, pending, dt_s / steps, left * ticks // steps)
    x, before_nm = s.x, s.x[5]
    if not correct(k, s, wheel_angle, road_angle):
        return False
    if k.tuning.fade_gain > 0.0 and s.step_in_s <= -_CALM_S:
        _learn_fade(k, s, x[5] - before_nm)
    s.step_in_s -= dt_s
    if s.step_in_s <= 0.0 and abs(s.surprise) > k.tuning.surprise:
        _allow_step(k, s)
    x[9] = min(max(x[9], SHORTEST_DEAD_TIME_S), k.tuning.longest_dead_time_s)
    x[10] = min(max(x[10], k.tuning.shortest_lag_s), k.tuning.longest_lag_s)
    x[11] = min(max(x[11], _LEAST_RELEASE), _MOST_RELEASE)
    return True


class _Transition(NamedTuple):
    """What the transition's Jacobian is made of."""

    T: float
    left: float
    rolling: float
    by_dead_time: float
    by_lag: float
    by_release: float
    mu: float
    turned: float
    turned_sine: float
    by_x1: float
    by_x2: float
    wheel_by_mu: float
    wheel_by_nm: float
    road_by_mu: float
    road_by_nm: float
    d1: float


def _carried(
    t: _Transition,
    e_th1: float,
    e1: float,
    e_th2: float,
    e2: float,
    e_M: float,
    e_d: float,
    e_factor: float,
    e_cosine: float,
    e_sine: float,
    e_dead: float,
    e_lag: float,
    e_release: float,
) -> Tuple5:
    """The Jacobian times a vector of states: its first five; the others stay."""
    T, left, rolling, by_dead_time, by_lag, by_release, mu, turned, turned_sine, by_x1, by_x2, a, b, c, d, d1 = t
    e_mu = mu * (e_factor + turned * e_cosine + turned_sine * e_sine) + by_x1 * e1 + by_x2 * e2
    e_torque = e_M + e_d + d1 * e1
    return (
        e_th1 + T * e1,
        e1 + T * (a * e_mu + b * e_torque),
        e_th2 + T * e2,
        rolling * e2 + T * (c * e_mu + d * e_torque),
        left * e_M + by_dead_time * e_dead + by_lag * e_lag + by_release * e_release,
    )


def predict(k: EkfConstants, s: EkfState, pending: DelayState, T: float, ago: int) -> None:
    """Advance by `T` in s, which ends `ago` ticks before the newest command."""
    x, p = s.x, k.contact.parameters
    th1, x1, th2, x2, M = x[0], x[1], x[2], x[3], x[4]
    settled, later = arrived(k.delay, pending, x[9], ago)
    release = x[11] if settled < M else 1.0
    lag = x[10] * release
    left = elementary.exp(-T / lag)
    slip = braking_slip(x1, x2, p)
    if not 0.0 <= slip <= 1.0:
        raise ValueError(NOT_A_SLIP)
    turned_sine, turned = elementary.sin_cos(th1 / s.radius_ratio)
    mu = formula(p, slip)
    scale = x[6] + x[7] * turned + x[8] * turned_sine
    torque = settled + (M - settled) * 0.5 * (1.0 + left) + x[5]
    a1, a2, wheel_by_mu, road_by_mu, wheel_by_nm, road_by_nm = accelerations(k.contact, x1, x2, torque, scale * mu)
    steepness = scale * formula_slope(p, slip) / max(x2, 1.0)
    half, rolling, by_lag = 0.5 * T * T, 1.0 - T * p.d2 / p.J2, (M - settled) * left * T / elementary.raised(lag, 2)
    t = _Transition(
        T,
        left,
        rolling,
        (1.0 - left) * later,
        by_lag * release,
        by_lag * x[10] if settled < M else 0.0,
        mu,
        turned,
        turned_sine,
        -steepness * k.ratio,
        steepness * (1.0 - slip),
        wheel_by_mu,
        wheel_by_nm,
        road_by_mu,
        road_by_nm,
        p.d1,
    )
    s.wheel_by_factor, s.road_by_factor = wheel_by_mu * mu, road_by_mu * mu
    x[0], x[1], x[2], x[3] = th1 + T * x1 + half * a1, x1 + T * a1, th2 + T * x2 + half * a2, x2 + T * a2
    x[4] = settled + (M - settled) * left
    x[5] -= T * s.fade * _loss_by_fade(M, x[5], x1)
    _carry(s.P, t)
    _widen(k.tuning, s.P, T, (settled - M) / lag, x2)


def _loss_by_fade(M: float, d: float, x1: float) -> float:
    """Rate in N m/s at which a torque `M` that is off by `d` falls with a fade of 1/J, in a wheel with speed `x1`."""
    return M * (M + d) * x1


def _learn_fade(k: EkfConstants, s: EkfState, corrected_nm: float) -> None:
    """Learn the fade from what corrected the excess torque in this sample."""
    loss = _loss_by_fade(s.x[4], s.x[5], s.x[1])
    if loss > _LEAST_LOSS:
        s.fade = min(max(s.fade - k.tuning.fade_gain * corrected_nm / loss, 0.0), _MOST_FADE)


def _carry(P: list[Row], t: _Transition) -> None:
    """Carry the covariances along, first their rows, then their columns."""
    p5, p6, p7, p8, p9, p10, p11 = P[5], P[6], P[7], P[8], P[9], P[10], P[11]
    r = P[0]
    t0 = _carried(t, r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11])
    r = P[1]
    t1 = _carried(t, r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11])
    r = P[2]
    t2 = _carried(t, r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11])
    r = P[3]
    t3 = _carried(t, r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11])
    r = P[4]
    t4 = _carried(t, r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11])
    for r in (p5, p6, p7, p8, p9, p10, p11):
        r[0], r[1], r[2], r[3], r[4] = _carried(
            t, r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11]
        )
    for j in range(5):
        a, b, c, d, e, f, g = p5[j], p6[j], p7[j], p8[j], p9[j], p10[j], p11[j]
        r = P[j]
        r[0], r[1], r[2], r[3], r[4] = _carried(t, t0[j], t1[j], t2[j], t3[j], t4[j], a, b, c, d, e, f, g)
        r[5], r[6], r[7], r[8], r[9], r[10], r[11] = a, b, c, d, e, f, g


def _widen(k: EkfTuning, P: list[Row], T: float, swing: float, x2: float) -> None:
    """Add the walks of a step of `T` in s, with the brake's torque changing by `swing` in N m/s."""
    P[1][1] += T * elementary.raised(k.wheel_walk_rad_s, 2)
    P[3][3] += T * elementary.raised(k.road_walk_rad_s, 2)
    P[4][4] += T * (elementary.raised(k.lag_torque_walk_nm, 2) + elementary.raised(k.lag_torque_per_swing * swing, 2))
    P[5][5] += T * (elementary.raised(k.torque_walk_nm, 2) + elementary.raised(k.torque_per_swing * swing, 2))
    P[6][6] += T * elementary.raised(k.adhesion_walk * x2 / _WALK_AT_RAD_S, 2)


def correct(k: EkfConstants, s: EkfState, wheel_angle: float, road_angle: float) -> bool:
    """Sequential correction by both angles: the second uses the covariance that the first leaves.

    A time between stamp and counts adds its variance times [x1 x2]'*[x1 x2] to that of the angles. Of the road's angle
    as much of the wheel's is taken as the two errors have in common, so that what is left is independent. Where a
    variance is not above 0, as rounding may leave it far from the model, the covariance begins again instead.
    """
    P, x = s.P, s.x
    wheel_error = wheel_angle * s.radius_ratio - x[0]
    if not (abs(wheel_error) < _LOST_RAD and abs(road_angle - x[2]) < _LOST_RAD):
        return False  # also catches NaN
    r = P[0]
    w0, w1, w2, w3, w4, w5, w6 = r[0], r[1], r[2], r[3], r[4], r[5], r[6]
    w7, w8, w9, w10, w11 = r[7], r[8], r[9], r[10], r[11]
    w = w0, w1, w2, w3, w4, w5, w6, w7, w8, w9, w10, w11
    jitter, common = k.noise + k.jitter * x[1] * x[1], k.jitter * x[1] * x[3]
    wheel_variance = w0 + jitter
    if wheel_variance <= 0.0:
        _restart_covariance(k, s)
        return True
    wheel_scale, taken = 1.0 / wheel_variance, common / jitter
    r, b = P[2], w2 * wheel_scale + taken * (1.0 - w0 * wheel_scale)
    v0, v1, v2, v3, v4, v5 = r[0] - b * w0, r[1] - b * w1, r[2] - b * w2, r[3] - b * w3, r[4] - b * w4, r[5] - b * w5
    v6, v7, v8, v9, v10 = r[6] - b * w6, r[7] - b * w7, r[8] - b * w8, r[9] - b * w9, r[10] - b * w10
    v11 = r[11] - b * w11
    road_variance = v2 - taken * v0 + (k.noise + k.jitter * x[3] * x[3] - taken * common)
    if road_variance <= 0.0:
        _restart_covariance(k, s)
        return True
    s.surprise += k.tuning.surprise_gain * (wheel_error * math.sqrt(wheel_scale) - s.surprise)
    road_error = road_angle - x[2] - b * wheel_error
    v = v0, v1, v2, v3, v4, v5, v6, v7, v8, v9, v10, v11
    road_scale = 1.0 / road_variance
    for i in range(12):
        a, b, r = w[i] * wheel_scale, v[i] * road_scale, P[i]
        x[i] = x[i] + a * wheel_error + b * road_error
        r[0] = r[0] - a * w0 - b * v0
        r[1] = r[1] - a * w1 - b * v1
        r[2] = r[2] - a * w2 - b * v2
        r[3] = r[3] - a * w3 - b * v3
        r[4] = r[4] - a * w4 - b * v4
        r[5] = r[5] - a * w5 - b * v5
        r[6] = r[6] - a * w6 - b * v6
        r[7] = r[7] - a * w7 - b * v7
        r[8] = r[8] - a * w8 - b * v8
        r[9] = r[9] - a * w9 - b * v9
        r[10] = r[10] - a * w10 - b * v10
        r[11] = r[11] - a * w11 - b * v11
    return True


def _allow_step(k: EkfConstants, s: EkfState) -> None:
    """Add the covariance of a step of the adhesion `step_delay_s` ago, and of its effect on the wheels since."""
    ago, size = k.tuning.step_delay_s, k.tuning.step_adhesion
    wheel, road = s.wheel_by_factor, s.road_by_factor
    half = 0.5 * ago * ago
    moved = size * (half * wheel), size * (ago * wheel), size * (half * road), size * (ago * road), 0.0, 0.0, size
    for i in range(7):
        for j in range(7):
            s.P[i][j] += moved[i] * moved[j]
    s.surprise, s.step_in_s = 0.0, _STEP_PAUSE_S
