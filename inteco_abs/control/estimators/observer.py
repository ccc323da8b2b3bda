"""The model-based observer: it uses the commands, and estimates what the nominal model does not know."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.base import Angles
from inteco_abs.control.estimators.braking_ekf import BrakingEkf, EkfTuning
from inteco_abs.control.estimators.eccentricity import EccentricityFilter
from inteco_abs.control.estimators.prediction import braking_slip
from inteco_abs.control.estimators.registry import EstimatorSpec
from inteco_abs.rig import MEASURED_MAP, BrakeMap, RigParameters, nominal_brake_map
from inteco_abs.signals import Command, Estimate, Sample

_BRAKING_FROM_RAD_S: Final = 10.0
_BRAKING_UNTIL_RAD_S: Final = 2.0
"""Of the road; below, the slip has no meaning."""
_HANDED_OVER_SD: Final = 2.0
"""Standard deviation of the speeds at the hand-over to the wheels' filters, rad/s."""
_LONGEST_GAP_S: Final = 0.2
"""After a longer gap the state is worthless, and catching up would take longer than a period."""
_SAMPLES: Final = 3
"""Samples until there is a speed."""


class Observer:
    """A filter per wheel while the wheels roll, which learns the encoders' discs; one for the rig while it brakes.

    Braking begins when the drive is off while the road turns. Only from then on estimates have a prediction.
    """

    __slots__ = ("_angles", "_braking", "_discs", "_filter", "_parameters", "_period_s", "_samples")

    def __init__(
        self,
        parameters: RigParameters,
        counts_per_turn: int,
        period_s: float,
        spread: EkfTuning | None = None,
        brake_map: BrakeMap = MEASURED_MAP,
    ) -> None:
        spread = spread or EkfTuning()
        count_rad = 2.0 * math.pi / counts_per_turn
        self._angles = Angles(counts_per_turn), Angles(counts_per_turn)
        self._discs = tuple(EccentricityFilter(count_rad, spread.count_noise * count_rad) for _ in range(2))
        self._filter = BrakingEkf(parameters, brake_map, spread, count_rad, period_s)
        self._parameters = parameters
        self._period_s = period_s
        self._braking = False
        self._samples = 0

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:
        """Estimate at the instant of `sample`; valid from the third sample on."""
        wheel_angle, dt_s = self._angles[0].update(sample.time_ns, sample.wheel_count)
        road_angle, _ = self._angles[1].update(sample.time_ns, sample.road_count)
        self._samples += 1
        ticks = max(1, round(dt_s / self._period_s))
        self._filter.tell(command.brake, ticks)
        wheel, road = self._discs
        if self._braking:
            angles = wheel.straight(wheel_angle), road.straight(road_angle)
            found = dt_s <= _LONGEST_GAP_S and self._filter.update(*angles, dt_s, ticks)
            wheel_speed, road_speed = self._filter.speeds
            if not found:
                self._braking = False
                wheel.restart(wheel_angle)
                road.restart(road_angle)
            elif command.drive > 0.0 or road_speed < _BRAKING_UNTIL_RAD_S:
                self._braking = False
                wheel.restart(wheel_angle, wheel_speed, _HANDED_OVER_SD)
                road.restart(road_angle, road_speed, _HANDED_OVER_SD)
        else:
            wheel.update(wheel_angle, dt_s)
            road.update(road_angle, dt_s)
            if command.drive <= 0.0 and road.speed > _BRAKING_FROM_RAD_S and self._samples >= _SAMPLES:
                self._braking = True
                self._filter.begin(wheel, road)
        return self._estimate()

    def _estimate(self) -> Estimate:
        wheel_speed, road_speed = self._filter.speeds if self._braking else (disc.speed for disc in self._discs)
        slip = braking_slip(wheel_speed, road_speed, self._parameters)
        outlook = self._filter.outlook() if self._braking else None
        return Estimate(wheel_speed, road_speed, slip, self._samples >= _SAMPLES, outlook)


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
