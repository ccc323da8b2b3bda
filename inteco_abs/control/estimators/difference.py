"""The difference over 10 ms of the vendor's demonstrations, held between two updates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.base import Estimator, TwoWheels
from inteco_abs.control.estimators.registry import EstimatorSpec, parameter
from inteco_abs.control.functions import Function
from inteco_abs.rig import RigParameters

_DEAD_ZONE_M_S: Final = 0.05
SLIP_OFFSET_M_S: Final = 0.01
"""Added to the road's rim speed in the denominator of the slip."""


@dataclass(frozen=True, slots=True)
class DifferenceConstants:
    """Constants of one wheel."""

    angle_ns: float
    """Angle of one count in rad, times 1e9: speeds come from times in ns."""
    zone_rad_s: float
    due_ns: float
    """T0, less what a sample may come early."""


@dataclass(slots=True)
class DifferenceState:
    """Time and count of the newest difference, and its speed in rad/s."""

    then_ns: int = -1
    count: int = 0
    speed: float = 0.0


def difference(k: DifferenceConstants, s: DifferenceState, time_ns: int, count: int) -> float:
    """Speed in rad/s behind the dead zone; 0 until the first T0 is over."""
    elapsed_ns = time_ns - s.then_ns
    if s.then_ns < 0:
        s.then_ns, s.count = time_ns, count
    elif elapsed_ns > 0 and elapsed_ns >= k.due_ns:
        speed = (count - s.count) * k.angle_ns / elapsed_ns
        s.speed = math.copysign(max(0.0, abs(speed) - k.zone_rad_s), speed)
        s.then_ns, s.count = time_ns, count
    return s.speed


class HeldDifference(DifferenceState):
    """Every T0 = `hold_s`: (count - count a T0 ago)*2 pi/(N*T0), its rim speed through a dead zone, held for T0.

    The dead zone of +-0.05 m/s takes this much off what is beyond it, as Simulink's block does: 0.5 rad/s of either
    wheel. Lag: T0/2 when fresh, 3*T0/2 when oldest, T0 in the mean. Noise: (2 pi/(N*T0))/sqrt(6) by counting, 0.125
    rad/s with 2048 counts in 10 ms, and a*T0/sqrt(12) by holding at the deceleration a, 0.39 rad/s in a stop.
    T0, zone and offset are the toolbox's; that the zone subtracts is inferred
    (docs/facts/rig.md#measurement-and-limits).
    """

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(difference)

    def __init__(self, counts_per_turn: int, radius_m: float, hold_s: float, period_s: float) -> None:
        super().__init__()
        due_ns = (hold_s - 0.5 * period_s) * 1e9  # tolerates samples that come a little early
        self.k = DifferenceConstants(2.0 * math.pi / counts_per_turn * 1e9, _DEAD_ZONE_M_S / radius_m, due_ns)

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s behind the dead zone; 0 until the first T0 is over."""
        return difference(self.k, self, time_ns, count)


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
