"""The model-based observer: it uses the commands, and estimates what the nominal model does not know."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Final

from inteco_abs import elementary
from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.angles import rad_per_count, turned
from inteco_abs.control.estimators.braking_ekf import (
    MISLED_SD,
    SHORTEST_DEAD_TIME_S,
    EkfConstants,
    EkfState,
    EkfTuning,
    begin,
    braking_ekf,
)
from inteco_abs.control.estimators.eccentricity import (
    ANY_SPEED_SD,
    DiscConstants,
    DiscState,
    disc_constants,
    follow,
    follow_braked,
    restart,
    rolling_wheel,
    straight,
)
from inteco_abs.control.estimators.prediction import DelayLine, DelayState, arrived, braking_slip, outlook, tell
from inteco_abs.control.estimators.registry import EstimatorSpec, parameter
from inteco_abs.control.functions import Function
from inteco_abs.control.wheel_dynamics import WheelDynamics
from inteco_abs.rig import MEASURED_MAP, BrakeMap, RigParameters, nominal_brake_map
from inteco_abs.rig.brake_map import Points, interpolated
from inteco_abs.signals import Command, Estimate, Sample

_BRAKING_FROM_RAD_S: Final = 10.0
_BRAKING_UNTIL_RAD_S: Final = 2.0
"""Speed of the road below which the slip has no meaning."""
_HANDED_OVER_SD: Final = 2.0
"""Standard deviation of the speeds at the hand-over to the wheels' filters, rad/s."""
_LONGEST_GAP_S: Final = 0.2
"""After a longer gap the state is worthless, and catching up would take longer than a period."""
_SAMPLES: Final = 3
"""Samples until there is a speed."""
_LATEST_ONSET: Final = 7.0 / 6.0
"""Time after the first command after which the brake acts for certain, in longest dead times."""
_DEPARTED: Final = 0.5
"""Mean deviation from rolling, in standard deviations, at which it acts."""
_NOTICED_S: Final = 0.015
"""Time from the onset to that deviation."""
_ONSET_SD_S: Final = 0.008
"""Standard deviation of a dead time that was found by its onset."""
_GROWN: Final = 1.6
"""Mean deviation whose time after that shows the lag: 3 ms without lag, 9 ms for one of 50 ms."""
_QUICK_GROWTH_S: Final = 0.006
"""That time below which a brake is quick: its lag is then 6.5 times what exceeds 2.7 ms."""
_LAG_BY_GROWTH: Final = 6.5
_LEAST_GROWTH_S: Final = 0.0027
_LONGEST_QUICK_LAG_S: Final = _LAG_BY_GROWTH * (_QUICK_GROWTH_S - _LEAST_GROWTH_S)
_QUICKLY_NOTICED_S: Final = 0.006
_NOTICED_BY_LAG: Final = 0.37
"""A quick brake is noticed after 6 ms and this share of its lag."""
_BRAKE: Final = (4, 5, 9, 10)
_QUICK_SD: Final = (1.0, 0.34, 0.003, 0.004)
"""Of its torque, excess torque, dead time and lag."""
_QUICK_SHARE: Final = 0.3
"""Standard deviation of its lag as a share, besides."""
_CAUTION_SD: Final = 0.5
"""Standard deviations by which the slowest release that the law reckons with exceeds the estimated one."""
_RATIO_S: Final = 0.15
"""Time constant of the means by which the radii are compared: their eccentric discs turn a few times in it."""
_RATIO_FROM_RAD_S: Final = 60.0
_SAME_RADII: Final = 0.0012
"""Deviation of the ratio that differences of creep explain: the published radii hold."""


@dataclass(frozen=True, slots=True)
class ObserverConstants:
    """Constants of the filters of wheels and rig."""

    disc: DiscConstants
    ekf: EkfConstants
    per_count: float
    """rad"""
    points: Points
    """Points of the brake's map."""
    ratio_gain: float
    """Weight of a period in the means by which the radii are compared; 0 where they are not."""
    latest_onset_s: float
    """Time after the first command after which the brake acts for certain."""


@dataclass(slots=True)
class ObserverState:
    """State of both wheels, which are followed while they roll, and of the rig, which is while it brakes."""

    wheel: DiscState
    road: DiscState
    ekf: EkfState
    pending: DelayState
    braking: bool = False
    samples: int = 0
    asked_s: float = 0.0
    """Time since the first torque of this braking was commanded."""
    acted_s: float = 0.0
    """That at which the wheel departed from rolling; 0 before."""
    growth_s: float = 0.0
    """Time since then in which the departure grew."""
    departure: float = 0.0
    """Mean deviation of the wheel from one that still rolls, each over its standard deviation."""
    wheel_mean: float = 0.0
    """Mean speed of the wheel in the run-up, rad/s, and so on."""
    road_mean: float = 0.0
    acceleration_mean: float = 0.0


def observe(k: ObserverConstants, s: ObserverState, sample: Sample, command: Command) -> Estimate:
    """Estimate at the instant of `sample`; valid from the third sample on."""
    _, time_ns, _, wheel_count, road_count, _ = sample
    drive, brake = command
    wheel_angle, dt_s = turned(k.per_count, s.wheel, time_ns, wheel_count)
    road_angle, _ = turned(k.per_count, s.road, time_ns, road_count)
    s.samples += 1
    ticks = max(1, round(dt_s / k.ekf.delay.period_s))
    tell(k.ekf.delay, s.pending, interpolated(k.points, brake), ticks)
    if s.braking:
        _brake(k, s, wheel_angle, road_angle, dt_s, ticks, drive)
    else:
        follow(k.disc, s.wheel, wheel_angle, dt_s)
        follow(k.disc, s.road, road_angle, dt_s)
        if k.ratio_gain > 0.0 and drive > 0.0 and s.road.speed > _RATIO_FROM_RAD_S:
            _compare_radii(k, s)
        if drive <= 0.0 and s.road.speed > _BRAKING_FROM_RAD_S and s.samples >= _SAMPLES:
            released = s.pending.torques[s.pending.newest - 1] == 0.0
            s.braking, s.asked_s, s.departure = True, 0.0 if released else k.latest_onset_s, 0.0
            s.acted_s = s.growth_s = 0.0
            begin(k.ekf, s.ekf, s.pending, s.wheel, s.road)
    braking, x, ratio = s.braking, s.ekf.x, s.ekf.radius_ratio
    wheel_speed, road_speed = (x[1] / ratio, x[3]) if braking else (s.wheel.speed, s.road.speed)
    slip = braking_slip(wheel_speed * ratio, road_speed, k.ekf.contact.parameters)
    slowest = x[11] + _CAUTION_SD * math.sqrt(max(s.ekf.P[11][11], 0.0))
    seen = outlook(k.ekf.contact, k.ekf.delay, s.pending, x, ratio, slowest) if braking else None
    return Estimate(wheel_speed, road_speed, slip, s.samples >= _SAMPLES, seen)


def _compare_radii(k: ObserverConstants, s: ObserverState) -> None:
    """Learn the ratio of the radii from the speeds of wheels that roll, but for the creep that drives the wheel along.

    By (2), adhesion times r1*Fn accelerates the wheel against its friction, with Fn of (5); near zero slip equation
    (8) is mu = w4*slip^p/(a + slip^p), which gives the slip of that adhesion.
    """
    gain = k.ratio_gain if s.road_mean > 0.0 else 1.0
    s.wheel_mean += gain * (s.wheel.speed - s.wheel_mean)
    s.road_mean += gain * (s.road.speed - s.road_mean)
    s.acceleration_mean += gain * (s.wheel.acceleration - s.acceleration_mean)
    contact, p = k.ekf.contact, k.ekf.contact.parameters
    friction = p.d1 * s.wheel_mean + p.M10
    mu = max(0.0, p.J1 * s.acceleration_mean + friction) * contact.sin / ((p.Mg + friction) * p.r1)
    creep = elementary.power(p.a * mu / (p.w4 - mu), 1.0 / p.p) if mu < 0.5 * p.w4 else 0.0
    ratio = (1.0 - creep) * s.road_mean / (k.ekf.ratio * s.wheel_mean)
    s.ekf.radius_ratio = ratio if abs(ratio - 1.0) > _SAME_RADII else 1.0


def _brake(
    k: ObserverConstants,
    s: ObserverState,
    wheel_angle: float,
    road_angle: float,
    dt_s: float,
    ticks: int,
    drive: float,
) -> None:
    """Advance the rig's filter, and hand the wheels over to theirs where it is lost or braking has ended."""
    disc, wheel, road, x = k.disc, s.wheel, s.road, s.ekf.x
    angles = straight(wheel, wheel_angle), straight(road, road_angle)
    if not (dt_s <= _LONGEST_GAP_S and braking_ekf(k.ekf, s.ekf, s.pending, angles[0], angles[1], dt_s, ticks)):
        s.braking = False
        restart(disc, wheel, wheel_angle, 0.0, ANY_SPEED_SD)
        restart(disc, road, road_angle, 0.0, ANY_SPEED_SD)
    elif drive > 0.0 or x[3] < _BRAKING_UNTIL_RAD_S:
        s.braking = False
        restart(disc, wheel, wheel_angle, x[1] / s.ekf.radius_ratio, _HANDED_OVER_SD)
        restart(disc, road, road_angle, x[3], _HANDED_OVER_SD)
    elif k.ekf.tuning.finds_onset and s.asked_s < k.latest_onset_s:
        _find_onset(k, s, wheel_angle, road_angle, dt_s)


def _find_onset(k: ObserverConstants, s: ObserverState, wheel_angle: float, road_angle: float, dt_s: float) -> None:
    """Find dead time and lag by the instant at which the wheel departs from rolling, and by how quickly it does.

    The filter is linear about one dead time and one lag, and cannot find those that are far from them.
    """
    if s.pending.torques[s.pending.newest] > 0.0:
        s.asked_s += dt_s
    wheel, road, x, P = s.wheel, s.road, s.ekf.x, s.ekf.P
    rolling = wheel.speed / max(road.speed, 1.0)
    late = _ahead_of_prediction(road, road_angle, dt_s)  # as much of it as is common to both is the time stamp's
    variance = wheel.P[0][0] + k.disc.noise + rolling * rolling * (road.P[0][0] + k.disc.noise)
    deviation = (_ahead_of_prediction(wheel, wheel_angle, dt_s) - rolling * late) / math.sqrt(variance)
    s.departure += k.ekf.tuning.surprise_gain * (deviation - s.departure)
    if s.acted_s > 0.0:
        s.growth_s += dt_s
        follow_braked(k.disc, wheel, wheel_angle, dt_s)
        follow_braked(k.disc, road, road_angle, dt_s)
        if s.growth_s >= _QUICK_GROWTH_S:
            s.asked_s = k.latest_onset_s
            if s.acted_s - _NOTICED_S < k.ekf.tuning.dead_time_s - _ONSET_SD_S:
                _move_onset(k, s, x[0], x[1], x[2], x[3])
        elif s.departure < -_GROWN:
            s.asked_s = k.latest_onset_s
            _take_for_quick(k, s)
        return
    follow(k.disc, wheel, wheel_angle, dt_s)
    follow(k.disc, road, road_angle, dt_s)
    if s.departure < -_DEPARTED:
        s.acted_s = s.asked_s
        if x[9] < s.acted_s - _NOTICED_S - _ONSET_SD_S:
            ratio = s.ekf.radius_ratio
            _move_onset(k, s, wheel.angle * ratio, wheel.speed * ratio, road.angle, road.speed)
    elif s.ekf.surprise > k.ekf.tuning.surprise and x[9] < s.asked_s:
        begin(k.ekf, s.ekf, s.pending, wheel, road)
        x[4], x[9] = 0.0, s.asked_s
        P[4][4], P[9][9] = 0.0, elementary.raised(_ONSET_SD_S, 2)


def _move_onset(k: ObserverConstants, s: ObserverState, th1: float, x1: float, th2: float, x2: float) -> None:
    """Begin again with the dead time that the onset shows, and these angles and speeds of wheel and road."""
    x, P = s.ekf.x, s.ekf.P
    begin(k.ekf, s.ekf, s.pending, s.wheel, s.road)
    x[0], x[1], x[2], x[3] = th1, x1, th2, x2
    x[4] *= 1.0 - elementary.exp(-(_NOTICED_S + s.growth_s) / x[10])
    x[9] = max(SHORTEST_DEAD_TIME_S, s.acted_s - _NOTICED_S)
    P[1][1] += elementary.raised(MISLED_SD[1], 2)
    P[4][4], P[9][9] = elementary.raised(0.5 * x[4], 2), elementary.raised(_ONSET_SD_S, 2)


def _take_for_quick(k: ObserverConstants, s: ObserverState) -> None:
    """Begin again with a brake of the lag that the departure's growth shows.

    The shorter that is, the nearer to 1 its factor in releasing is expected: of a slower brake that passes for a quick
    one, a long one of these shows.
    """
    x, P, tuning = s.ekf.x, s.ekf.P, k.ekf.tuning
    th1, x1, th2, x2 = x[0], x[1], x[2], x[3]
    begin(k.ekf, s.ekf, s.pending, s.wheel, s.road)
    x[0], x[1], x[2], x[3] = th1, x1, th2, x2
    for i in range(4):
        for j in range(4):
            P[i][j] = 0.0
        P[i][i] = elementary.raised(MISLED_SD[i], 2)
    lag_s = max(_LAG_BY_GROWTH * (s.growth_s - _LEAST_GROWTH_S), tuning.shortest_lag_s)
    noticed_s = _QUICKLY_NOTICED_S + _NOTICED_BY_LAG * lag_s
    x[9], x[10] = max(SHORTEST_DEAD_TIME_S, s.acted_s - noticed_s), lag_s
    x[11] = 1.0 + (x[11] - 1.0) * (lag_s / _LONGEST_QUICK_LAG_S)
    settled, _ = arrived(k.ekf.delay, s.pending, x[9], 0)
    x[4] = settled * (1.0 - elementary.exp(-(noticed_s + s.growth_s) / lag_s))
    for i in range(4):
        P[_BRAKE[i]][_BRAKE[i]] = elementary.raised(_QUICK_SD[i], 2)
    P[10][10] += elementary.raised(_QUICK_SHARE * lag_s, 2)


def _ahead_of_prediction(s: DiscState, angle: float, dt_s: float) -> float:
    """Deviation of a rolling wheel from where its filter expects it, in rad, with the disc's `angle`."""
    return straight(s, angle) - s.angle - dt_s * (s.speed + 0.5 * dt_s * s.acceleration)


class Observer(ObserverState):
    """A filter per wheel while the wheels roll, which learns the encoders' discs; one for the rig while it brakes.

    Braking begins when the drive is off while the road turns. Only from then on estimates have a prediction.
    """

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(observe)

    def __init__(
        self,
        parameters: RigParameters,
        counts_per_turn: int,
        period_s: float,
        spread: EkfTuning | None = None,
        brake_map: BrakeMap = MEASURED_MAP,
    ) -> None:
        spread, count_rad = spread or EkfTuning(), rad_per_count(counts_per_turn)
        pending = DelayLine(period_s, spread.longest_dead_time_s)
        jitter = elementary.raised(spread.latch_jitter_s, 2)
        disc = disc_constants(count_rad, spread.count_noise * count_rad, jitter, learns_second=spread.learns_second)
        ratio, noise = parameters.r1 / parameters.r2, elementary.raised(spread.count_noise * count_rad, 2)
        ekf = EkfConstants(WheelDynamics(parameters), pending.k, spread, ratio, noise, jitter)
        super().__init__(rolling_wheel(disc), rolling_wheel(disc), EkfState(), pending)
        gain = period_s / _RATIO_S if spread.learns_radius else 0.0
        latest = round(spread.longest_dead_time_s * _LATEST_ONSET, 6)
        self.k = ObserverConstants(disc, ekf, count_rad, brake_map.points, gain, latest)

    @property
    def learnt(self) -> dict[str, float]:
        """What it learnt of the brake in the last stop, as keys of `model.identified`; empty before one."""
        lag_s = self.ekf.x[10]
        if lag_s == 0.0:
            return {}
        return {"c31": 1.0 / lag_s, "brake_dead_time_s": self.ekf.x[9], "brake_release_ratio": self.ekf.x[11]}

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:
        """Estimate at the instant of `sample`; valid from the third sample on."""
        return observe(self.k, self, sample, command)


def _observer(tuning: EkfTuning, config: RigConfig, parameters: RigParameters) -> Observer:
    own = config.model.identified
    spread = replace(
        tuning,
        dead_time_s=tuning.dead_time_s if own.brake_dead_time_s is None else own.brake_dead_time_s,
        lag_s=tuning.lag_s if own.c31 is None else 1.0 / own.c31,
        release_ratio=tuning.release_ratio if own.brake_release_ratio is None else own.brake_release_ratio,
    )
    per_turn, brake_map = config.encoders.counts_per_turn, nominal_brake_map(config.model)
    return Observer(parameters, per_turn, 1.0 / config.loop.rate_hz, spread, brake_map)


ANY_BRAKE: Final = EkfTuning(
    dead_time_sd_s=0.0035,
    lag_sd_s=0.05,
    adhesion_sd=0.13,
    adhesion_walk=0.054,
    ripple_sd=0.008,
    torque_sd_nm=0.05,
    torque_walk_nm=0.6,
    torque_per_swing=0.027,
    lag_torque_walk_nm=0.022,
    lag_torque_per_swing=0.0035,
    wheel_walk_rad_s=1.0,
    road_walk_rad_s=0.068,
    count_noise=1.53,
    step_adhesion=0.027,
    surprise=0.73,
    surprise_gain=0.143,
    shortest_lag_s=0.002,
    longest_lag_s=0.120,
    release_ratio=1.87,
    release_sd=1.62,
    latch_jitter_s=0.000052,
    fade_gain=2.0,
    learns_radius=True,
    learns_second=True,
    finds_onset=True,
)
"""For any brake and any tyre: it accepts more than `EkfTuning`, and expects less of lag and release.

From `tools/tune_predictive adaptive --generations 40 --size 12 --draws 30 --sigma 0.3`; then walks of the wheel and the
torque and the ripple were moved by hand towards those of `EkfTuning`, until `rough` and fade fell no more.
"""


def _any_brake(config: RigConfig, parameters: RigParameters) -> Observer:
    longest_s = config.estimator.longest_dead_time_s
    return _observer(replace(ANY_BRAKE, longest_dead_time_s=longest_s), config, parameters)


SPEC: Final = EstimatorSpec(
    "Extended Kalman filter of wheels, brake and contact, which learns the encoders' discs in the run-up",
    (),
    partial(_observer, EkfTuning()),
    Observer,
)
ADAPTIVE: Final = EstimatorSpec(
    "The observer for any brake and tyre: wide bounds for lag and dead time, latching jitter, the ratio of the radii",
    (parameter("longest_dead_time_s", "s", "longest dead time of the brake that it takes for possible"),),
    _any_brake,
    Observer,
)
