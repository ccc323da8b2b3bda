"""The difference over 10 ms of the vendor's demonstrations, held between two updates."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.base import Estimator, TwoWheels
from inteco_abs.control.estimators.registry import EstimatorSpec, parameter
from inteco_abs.rig import RigParameters

_DEAD_ZONE_M_S: Final = 0.05
SLIP_OFFSET_M_S: Final = 0.01
"""Added to the road's rim speed in the denominator of the slip."""


class HeldDifference:
    """Every T0 = `hold_s`: (count - count a T0 ago)*2 pi/(N*T0), its rim speed through a dead zone, held for T0.

    The dead zone of +-0.05 m/s takes this much off what is beyond it, as Simulink's block does: 0.5 rad/s of either
    wheel. Lag: T0/2 when fresh, 3*T0/2 when oldest, T0 in the mean. Noise: (2 pi/(N*T0))/sqrt(6) by counting, 0.125
    rad/s with 2048 counts in 10 ms, and a*T0/sqrt(12) by holding at the deceleration a, 0.39 rad/s in a stop.
    T0, zone and offset are the toolbox's; that the zone subtracts is inferred
    (docs/facts/rig.md#measurement-and-limits).
    """

    __slots__ = ("_angle_ns", "_count", "_due_ns", "_speed", "_then_ns", "_zone_rad_s")

    def __init__(self, counts_per_turn: int, radius_m: float, hold_s: float, period_s: float) -> None:
        self._angle_ns = 2.0 * math.pi / counts_per_turn * 1e9
        self._zone_rad_s = _DEAD_ZONE_M_S / radius_m
        self._due_ns = (hold_s - 0.5 * period_s) * 1e9  # tolerates samples that come a little early
        self._then_ns = -1
        self._count = 0
        self._speed = 0.0

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s behind the dead zone; 0 until the first T0 is over."""
        elapsed_ns = time_ns - self._then_ns
        if self._then_ns < 0:
            self._then_ns, self._count = time_ns, count
        elif elapsed_ns > 0 and elapsed_ns >= self._due_ns:
            speed = (count - self._count) * self._angle_ns / elapsed_ns
            self._speed = math.copysign(max(0.0, abs(speed) - self._zone_rad_s), speed)
            self._then_ns, self._count = time_ns, count
        return self._speed


def _difference(config: RigConfig, parameters: RigParameters) -> Estimator:
    per_turn, window_s, period_s = config.encoders.counts_per_turn, config.estimator.window_s, 1.0 / config.loop.rate_hz
    wheel = HeldDifference(per_turn, parameters.r1, window_s, period_s)
    road = HeldDifference(per_turn, parameters.r2, window_s, period_s)
    return TwoWheels(wheel, road, parameters, SLIP_OFFSET_M_S)


SPEC: Final = EstimatorSpec(
    "The vendor's demonstrations: difference over T0, held for T0, behind a dead zone of 0.05 m/s",
    (parameter("window_s", "s", "T0; the speed lags by as much in the mean"),),
    _difference,
    HeldDifference,
)
