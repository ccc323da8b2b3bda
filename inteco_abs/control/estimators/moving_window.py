"""Mean speeds over a moving window, and the Euler formula as the window of one period."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

from inteco_abs.config import RigConfig
from inteco_abs.control.count_speed import Window, WindowConstants, mean_speeds, window_constants
from inteco_abs.control.estimators.base import Estimator
from inteco_abs.control.estimators.registry import EstimatorSpec, parameter
from inteco_abs.control.functions import Function
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Command, Estimate, Sample


@dataclass(frozen=True, slots=True)
class Constants(WindowConstants):
    """Constants of the window and the wheels."""

    ratio: float
    """r1/r2"""


@dataclass(slots=True)
class State(Window):
    """The window's samples."""

    valid: bool = False


def moving_window(k: Constants, s: State, sample: Sample, command: Command) -> Estimate:  # noqa: ARG001  no model, no input
    """Estimate at the instant of `sample`; valid from the second sample on."""
    _, time_ns, _, wheel_count, road_count, _ = sample
    wheel, road = mean_speeds(k, s, time_ns, wheel_count, road_count)
    # as in `two_wheels` without an offset; written out, for a call would cost the default estimator's every tick
    slip = 1.0 - k.ratio * wheel / road if road > 0.0 else 0.0
    valid, s.valid = s.valid, True
    return Estimate(wheel, road, 0.0 if slip < 0.0 else min(slip, 1.0), valid, None)


class MovingWindow(State):
    """`TwoWheels` with a `MovingAverageSpeed` of `length` samples on each, in one step."""

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(moving_window)

    def __init__(self, counts_per_turn: int, length: int, parameters: RigParameters) -> None:
        super().__init__([0] * length, [0] * length, [0] * length)
        window = window_constants(counts_per_turn, length)
        self.k = Constants(window.angle_ns, window.length, parameters.r1 / parameters.r2)

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:
        """Estimate at the instant of `sample`; valid from the second sample on."""
        return moving_window(self.k, self, sample, command)


def _euler(config: RigConfig, parameters: RigParameters) -> Estimator:
    return MovingWindow(config.encoders.counts_per_turn, 1, parameters)


def _moving_window(config: RigConfig, parameters: RigParameters) -> Estimator:
    length = max(1, round(config.estimator.window_s * config.loop.rate_hz))
    return MovingWindow(config.encoders.counts_per_turn, length, parameters)


EULER: Final = EstimatorSpec("The paper's backward difference over one period", (), _euler, MovingWindow)

SPEC: Final = EstimatorSpec(
    "Mean speed over a window of samples",
    (parameter("window_s", "s", "length of the window; the speed lags by half of it"),),
    _moving_window,
    MovingWindow,
)
