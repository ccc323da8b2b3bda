"""The interface of estimators, and those that apply the same filter to both wheels.

Equal lag on both wheels cancels in the slip; unequal lag does not.
"""

from __future__ import annotations

import math
from typing import Protocol

from inteco_abs.control.count_speed import MovingAverageSpeeds
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Command, Estimate, Sample


class Estimator(Protocol):
    """Turns samples into estimates, one at a time, in order; no clock, no randomness."""

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:
        """Estimate at the instant of `sample`; `command` was sent in the same exchange and acts from then on.

        Only model-based estimators use it.
        """
        ...


class SpeedFilter(Protocol):
    """One wheel's speed from its count."""

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s at the sample taken at `time_ns`; 0 at the first sample."""
        ...


class TwoWheels:
    """The same filter on `wheel` and `road`, and the slip of braking, equation (11).

    The slip is clipped to 0..1, as equation (8) is not defined outside; a driven or resting wheel reads 0. An
    `offset_m_s` is added to the road's rim speed in the denominator: (v2 - v1)/(v2 + offset).
    """

    __slots__ = ("_offset", "_ratio", "_road", "_samples", "_wheel")

    def __init__(
        self, wheel: SpeedFilter, road: SpeedFilter, parameters: RigParameters, offset_m_s: float = 0.0
    ) -> None:
        self._wheel = wheel
        self._road = road
        self._ratio = parameters.r1 / parameters.r2
        self._offset = offset_m_s / parameters.r2
        self._samples = 0

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:  # noqa: ARG002  no model, no input
        """Estimate at the instant of `sample`; valid from the second sample on."""
        wheel = self._wheel.update(sample.time_ns, sample.wheel_count)
        road = self._road.update(sample.time_ns, sample.road_count)
        offset = self._offset
        slip = 1.0 - (self._ratio * wheel + offset) / (road + offset) if road > 0.0 else 0.0
        self._samples += 1
        return Estimate(wheel, road, 0.0 if slip < 0.0 else min(slip, 1.0), self._samples > 1)


class MovingWindow:
    """`TwoWheels` with a `MovingAverageSpeed` of `length` samples on each, in one step."""

    __slots__ = ("_ratio", "_valid", "_windows")

    def __init__(self, counts_per_turn: int, length: int, parameters: RigParameters) -> None:
        self._windows = MovingAverageSpeeds(counts_per_turn, length)
        self._ratio = parameters.r1 / parameters.r2
        self._valid = False

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:  # noqa: ARG002  no model, no input
        """Estimate at the instant of `sample`; valid from the second sample on."""
        _, time_ns, _, wheel_count, road_count, _ = sample
        wheel, road = self._windows.update(time_ns, wheel_count, road_count)
        slip = 1.0 - self._ratio * wheel / road if road > 0.0 else 0.0
        valid, self._valid = self._valid, True
        return Estimate(wheel, road, 0.0 if slip < 0.0 else min(slip, 1.0), valid)


class Angles:
    """Angle in rad since the first sample, and the time in s since the sample before."""

    __slots__ = ("_before_ns", "_origin", "_per_count")

    def __init__(self, counts_per_turn: int) -> None:
        self._per_count = 2.0 * math.pi / counts_per_turn
        self._origin = 0
        self._before_ns = -1

    def update(self, time_ns: int, count: int) -> tuple[float, float]:
        """Angle in rad and time in s; both 0 at the first sample."""
        if self._before_ns < 0:
            self._origin, self._before_ns = count, time_ns
        elapsed_s = (time_ns - self._before_ns) * 1e-9
        self._before_ns = time_ns
        return (count - self._origin) * self._per_count, elapsed_s
