"""Prediction of a braking rig's state over the brake's dead time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from inteco_abs.control.wheel_dynamics import WheelDynamics
from inteco_abs.rig import RigParameters, adhesion
from inteco_abs.signals import Prediction

LONGEST_DEAD_TIME_S: Final = 0.030


class DelayLine:
    """Commands on their way to the brake, each as the torque in N m that the brake settles to."""

    __slots__ = ("_period_s", "_torques")

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        ticks = int(LONGEST_DEAD_TIME_S / period_s) + 4
        self._torques = deque([0.0] * ticks, ticks)  # the newest is last

    def tell(self, torque: float, ticks: int) -> None:
        """Add the command in force from the current sample on; in the `ticks` ticks before, the previous one was."""
        self._torques.extend([self._torques[-1]] * min(ticks - 1, len(self._torques)))
        self._torques.append(torque)

    @property
    def newest(self) -> float:
        """The last command."""
        return self._torques[-1]

    def arrived(self, dead_time: float, ago: int = 0) -> tuple[float, float]:
        """What acted on the brake in the period that ended `ago` ticks ago; its derivative by the dead time in s."""
        ticks, late = self._split(dead_time)
        newest = min(ticks + ago, len(self._torques) - 3)
        newer, older = self._torques[-2 - newest], self._torques[-3 - newest]
        return newer + late * (older - newer), (older - newer) / self._period_s

    def ahead(self, torque: float, dead_time: float, lag: float) -> tuple[float, float, float]:
        """From `torque` now: time in s until the next command acts, the torque then, and its mean until then."""
        ticks, late = self._split(dead_time)
        left = math.exp(-self._period_s / lag)
        total = 0.0
        for before, newest in pairwise(list(self._torques)[-ticks - 2 :]):
            settled = newest + late * (before - newest)
            total += settled + (torque - settled) * 0.5 * (1.0 + left)
            torque = settled + (torque - settled) * left
        return (ticks + 1) * self._period_s, torque, total / (ticks + 1)

    def _split(self, dead_time: float) -> tuple[int, float]:
        """Whole ticks, and the share of a tick beyond them."""
        ticks = dead_time / self._period_s
        return int(ticks), ticks - int(ticks)


def outlook(
    contact: WheelDynamics, parameters: RigParameters, pending: DelayLine, state: Sequence[float]
) -> Prediction:
    """Prediction from the states of `BrakingEkf`."""
    th1, x1, _, x2, lagged, excess, factor, cosine, sine, dead_time, lag = state
    horizon, then, mean = pending.ahead(lagged, dead_time, lag)
    halfway = th1 + 0.5 * horizon * x1
    scale = factor + cosine * math.cos(halfway) + sine * math.sin(halfway)
    mu = scale * adhesion(braking_slip(x1, x2, parameters), parameters)
    moving = contact.accelerations(x1, x2, mean + excess, mu)
    return Prediction(
        th1 + horizon * (x1 + 0.5 * horizon * moving.wheel),
        x1 + horizon * moving.wheel,
        x2 + horizon * moving.road,
        then,
        excess,
        factor,
        cosine,
        sine,
        dead_time,
        lag,
    )


def braking_slip(wheel_speed: float, road_speed: float, parameters: RigParameters) -> float:
    """Equation (11), within 0..1; 0 for a road that does not turn forward."""
    if road_speed <= 0.0:
        return 0.0
    slip = 1.0 - parameters.r1 * wheel_speed / (parameters.r2 * road_speed)
    return min(max(slip, 0.0), 1.0)
