"""Prediction of a braking rig's state over the brake's dead time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from inteco_abs import elementary
from inteco_abs.control.wheel_dynamics import WheelConstants, accelerations
from inteco_abs.rig import RigParameters
from inteco_abs.rig.friction import formula
from inteco_abs.signals import Prediction

NOT_A_SLIP: Final = "the observer's speeds are not numbers"


@dataclass(frozen=True, slots=True)
class DelayConstants:
    """Constants of a delay line."""

    period_s: float
    length: int
    """Commands that it holds."""


@dataclass(slots=True)
class DelayState:
    """Commands on their way to the brake, each as the torque in N m that the brake settles to."""

    torques: list[float]
    """A ring that is written twice, so that its content stands in one piece up to the newest."""
    newest: int
    """Place of the newest in the second half."""


class DelayLine(DelayState):
    """The commands of a dead time up to `longest_s`, at one a period."""

    __slots__ = ("k",)

    def __init__(self, period_s: float, longest_s: float) -> None:
        length = int(longest_s / period_s) + 4
        super().__init__([0.0] * (2 * length), length)
        self.k = DelayConstants(period_s, length)

    def tell(self, torque: float, ticks: int) -> None:
        """Add a command, as the function `tell` does."""
        tell(self.k, self, torque, ticks)


def tell(k: DelayConstants, s: DelayState, torque: float, ticks: int) -> None:
    """Add the command in force from the current sample on; in the `ticks` ticks before, the previous one was."""
    before = s.torques[s.newest]
    for _ in range(min(ticks - 1, k.length)):
        _append(k, s, before)
    _append(k, s, torque)


def _append(k: DelayConstants, s: DelayState, torque: float) -> None:
    newest = s.newest + 1
    if newest == 2 * k.length:
        newest = k.length
    s.newest = newest
    s.torques[newest] = s.torques[newest - k.length] = torque


def arrived(k: DelayConstants, s: DelayState, dead_time: float, ago: int) -> tuple[float, float]:
    """What acted on the brake in the period that ended `ago` ticks ago; its derivative by the dead time in s."""
    passed = dead_time / k.period_s
    ticks = int(passed)
    late = passed - ticks
    place = s.newest - 1 - min(ticks + ago, k.length - 3)
    newer, older = s.torques[place], s.torques[place - 1]
    return newer + late * (older - newer), (older - newer) / k.period_s


def ahead(
    k: DelayConstants, s: DelayState, torque: float, dead_time: float, lag: float, release_ratio: float
) -> tuple[float, float, float]:
    """Return the time in s until the next command acts, the torque then and its mean until then; now it is `torque`."""
    passed = dead_time / k.period_s
    ticks = int(passed)
    late = passed - ticks
    rising = elementary.exp(-k.period_s / lag)
    falling = rising if release_ratio == 1.0 else elementary.exp(-k.period_s / (lag * release_ratio))
    total, oldest = 0.0, s.newest - min(ticks + 1, k.length - 1)
    before = s.torques[oldest]
    for newest in s.torques[oldest + 1 : s.newest + 1]:
        settled = newest + late * (before - newest)
        away = torque - settled
        left = rising if away < 0.0 else falling
        total += settled + away * (0.5 * (1.0 + left))
        torque = settled + away * left
        before = newest
    return (ticks + 1) * k.period_s, torque, total / (ticks + 1)


def outlook(
    k: WheelConstants,
    delay: DelayConstants,
    pending: DelayState,
    state: Sequence[float],
    radius_ratio: float,
    slowest_release_ratio: float,
) -> Prediction:
    """Prediction from the states of `braking_ekf`, in which the wheel's angle is `radius_ratio` times the real one."""
    th1, x1, x2, factor, cosine, sine = state[0], state[1], state[3], state[6], state[7], state[8]
    excess, dead_time, lag, release_ratio = state[5], state[9], state[10], state[11]
    horizon, then, mean = ahead(delay, pending, state[4], dead_time, lag, release_ratio)
    halfway = th1 + 0.5 * horizon * x1
    turned_sine, turned = elementary.sin_cos(halfway / radius_ratio)
    scale = factor + cosine * turned + sine * turned_sine
    slip = braking_slip(x1, x2, k.parameters)
    if not 0.0 <= slip <= 1.0:
        raise ValueError(NOT_A_SLIP)
    wheel, road, _, _, _, _ = accelerations(k, x1, x2, mean + excess, scale * formula(k.parameters, slip))
    return Prediction(
        (th1 + horizon * (x1 + 0.5 * horizon * wheel)) / radius_ratio,
        x1 + horizon * wheel,
        x2 + horizon * road,
        then,
        excess,
        factor,
        cosine,
        sine,
        dead_time,
        lag,
        release_ratio,
        slowest_release_ratio,
    )


def braking_slip(wheel_speed: float, road_speed: float, parameters: RigParameters) -> float:
    """Equation (11), within 0..1; 0 for a road that does not turn forward, NaN for a speed that is not a number."""
    if road_speed <= 0.0:
        return 0.0
    # not by the ratio r1/r2 of `two_wheels`: it rounds otherwise, and recorded stops replay bit for bit
    slip = 1.0 - parameters.r1 * wheel_speed / (parameters.r2 * road_speed)
    if slip < 0.0:
        return 0.0
    return 1.0 if slip > 1.0 else slip  # noqa: FURB136  NaN stays NaN, compiled as well
