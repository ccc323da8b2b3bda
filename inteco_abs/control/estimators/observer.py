"""The model-based observer: it uses the commands, and estimates what the nominal model does not know."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

from inteco_abs import elementary
from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.angles import rad_per_count, turned
from inteco_abs.control.estimators.braking_ekf import (
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
    restart,
    rolling_wheel,
    straight,
)
from inteco_abs.control.estimators.prediction import DelayLine, DelayState, braking_slip, outlook, tell
from inteco_abs.control.estimators.registry import EstimatorSpec
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


@dataclass(frozen=True, slots=True)
class ObserverConstants:
    """Constants of the filters of wheels and rig."""

    disc: DiscConstants
    ekf: EkfConstants
    per_count: float
    """rad"""
    points: Points
    """Points of the brake's map."""


@dataclass(slots=True)
class ObserverState:
    """State of both wheels, which are followed while they roll, and of the rig, which is while it brakes."""

    wheel: DiscState
    road: DiscState
    ekf: EkfState
    pending: DelayState
    braking: bool = False
    samples: int = 0


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
        if drive <= 0.0 and s.road.speed > _BRAKING_FROM_RAD_S and s.samples >= _SAMPLES:
            s.braking = True
            begin(k.ekf, s.ekf, s.pending, s.wheel, s.road)
    braking, x = s.braking, s.ekf.x
    wheel_speed, road_speed = (x[1], x[3]) if braking else (s.wheel.speed, s.road.speed)
    slip = braking_slip(wheel_speed, road_speed, k.ekf.contact.parameters)
    seen = outlook(k.ekf.contact, k.ekf.delay, s.pending, x) if braking else None
    return Estimate(wheel_speed, road_speed, slip, s.samples >= _SAMPLES, seen)


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
        restart(disc, wheel, wheel_angle, x[1], _HANDED_OVER_SD)
        restart(disc, road, road_angle, x[3], _HANDED_OVER_SD)


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
        spread, count_rad, pending = spread or EkfTuning(), rad_per_count(counts_per_turn), DelayLine(period_s)
        disc = disc_constants(count_rad, spread.count_noise * count_rad)
        ratio, noise = parameters.r1 / parameters.r2, elementary.raised(spread.count_noise * count_rad, 2)
        ekf = EkfConstants(WheelDynamics(parameters), pending.k, spread, ratio, noise)
        super().__init__(rolling_wheel(disc), rolling_wheel(disc), EkfState(), pending)
        self.k = ObserverConstants(disc, ekf, count_rad, brake_map.points)

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:
        """Estimate at the instant of `sample`; valid from the third sample on."""
        return observe(self.k, self, sample, command)


def _observer(config: RigConfig, parameters: RigParameters) -> Observer:
    own = config.model.identified
    spread = EkfTuning(
        dead_time_s=EkfTuning().dead_time_s if own.brake_dead_time_s is None else own.brake_dead_time_s,
        lag_s=EkfTuning().lag_s if own.c31 is None else 1.0 / own.c31,
    )
    per_turn, brake_map = config.encoders.counts_per_turn, nominal_brake_map(config.model)
    return Observer(parameters, per_turn, 1.0 / config.loop.rate_hz, spread, brake_map)


SPEC: Final = EstimatorSpec(
    "Extended Kalman filter of wheels, brake and contact, which learns the encoders' discs in the run-up",
    (),
    _observer,
    Observer,
)
