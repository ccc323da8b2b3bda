"""The interface of estimators, and those that apply the same filter to both wheels.

Equal lag on both wheels cancels in the slip; unequal lag does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from inteco_abs.control.functions import Function, function_of
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


@dataclass(frozen=True, slots=True)
class TwoWheelsConstants:
    """Constants of both wheels, and of the filters if those are functions."""

    ratio: float
    """r1/r2"""
    offset: float
    """Speed in rad/s that is added to the road's in the slip's denominator."""
    wheel: Any
    road: Any


@dataclass(slots=True)
class TwoWheelsState:
    """State of the filters."""

    wheel: Any
    road: Any
    valid: bool = False


def two_wheels(
    k: TwoWheelsConstants,
    s: TwoWheelsState,
    sample: Sample,
    command: Command,  # noqa: ARG001  no model, no input
    speed: Function,
) -> Estimate:
    """Estimate at the instant of `sample` by the filters' function `speed`; valid from the second sample on."""
    _, time_ns, _, wheel_count, road_count, _ = sample
    wheel = speed(k.wheel, s.wheel, time_ns, wheel_count)
    road = speed(k.road, s.road, time_ns, road_count)
    offset = k.offset
    slip = 1.0 - (k.ratio * wheel + offset) / (road + offset) if road > 0.0 else 0.0
    valid, s.valid = s.valid, True
    return Estimate(wheel, road, 0.0 if slip < 0.0 else min(slip, 1.0), valid, None)


def _filtered(k: None, s: SpeedFilter, time_ns: int, count: int) -> float:  # noqa: ARG001  a filter of any class
    return s.update(time_ns, count)


class TwoWheels(TwoWheelsState):
    """One filter each for `wheel` and `road`, both of one kind, and the slip of braking, equation (11).

    The slip is clipped to 0..1, as equation (8) is not defined outside; a driven or resting wheel reads 0. An
    `offset_m_s` is added to the road's rim speed in the denominator: (v2 - v1)/(v2 + offset).
    """

    __slots__ = ("_speed", "k")

    def __init__(
        self, wheel: SpeedFilter, road: SpeedFilter, parameters: RigParameters, offset_m_s: float = 0.0
    ) -> None:
        super().__init__(wheel, road)
        speed = function_of(wheel) if type(wheel) is type(road) else None
        self._speed = speed or _filtered
        own = [getattr(each, "k", None) for each in (wheel, road)]
        self.k = TwoWheelsConstants(parameters.r1 / parameters.r2, offset_m_s / parameters.r2, *own)

    @property
    def function(self) -> Function | None:
        """Function of the filters, applied to both wheels."""
        return None if self._speed is _filtered else partial(two_wheels, speed=self._speed)

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:
        """Estimate at the instant of `sample`; valid from the second sample on."""
        return two_wheels(self.k, self, sample, command, self._speed)
