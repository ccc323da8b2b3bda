"""A rig's brake actuator, from the command at its terminals to the settled torque."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from inteco_abs.rig.actuators import brake_torque
from inteco_abs.rig.brake_map import BrakeMap
from inteco_abs.rig.variation import RigVariation

MEASURED_TORQUE: Final = (
    (0.415, 0.0),  # ASSUMED: the measured points begin above the published end of the dead zone
    (0.45, 0.17),
    (0.50, 0.26),
    (0.526, 1.40),
    (0.55, 1.87),
    (0.58, 2.84),
    (0.63, 3.72),
    (0.65, 4.28),
    (0.70, 4.83),
    (0.75, 5.62),
    (0.80, 5.91),
    (0.85, 5.97),
    (0.90, 6.47),
    (0.95, 7.85),
    (1.00, 9.37),
)
"""Duty and settled torque in N m, read off the manual's figure 5.6b; straight lines between, constant beyond."""
MEASURED_MAP: Final = BrakeMap(MEASURED_TORQUE)
SAME_TIME_S: Final = 1e-9
"""Times closer than this are equal: the sum of many ticks is not exact."""
EXACT: Final = 1e-9
"""Keeps a duty that is a whole number of steps from losing one to binary rounding."""


def measured_torque(duty: float) -> float:
    """Measured torque in N m at `duty`; 0 below the first point, the last point's value above it."""
    return MEASURED_MAP.torque(duty)


def measured_duty(torque: float) -> float:
    """Inverse of `measured_torque`: 0 for no torque, 1 above the largest one, NaN for NaN."""
    return MEASURED_MAP.duty(torque)


def settled_torque(duty: float, variation: RigVariation) -> float:
    """Settled torque in N m with `duty` (0..1) at the terminals: cap, PWM steps, static map."""
    duty = min(duty, variation.brake_duty_cap)
    steps = variation.brake_pwm_steps
    if steps > 0:
        duty = math.floor(duty * steps + EXACT) / steps
    duty -= variation.brake_duty_offset
    settled = measured_torque(duty) if variation.brake_map == "measured" else brake_torque(duty, variation.parameters)
    return variation.brake_gain * settled


class BrakeActuator:
    """A brake with dead time: commands act that much later. Times in s, never decreasing."""

    __slots__ = ("_coming", "_newest", "_variation", "settled_torque")

    def __init__(self, variation: RigVariation) -> None:
        self._variation = variation
        self._coming: deque[tuple[float, float]] = deque()
        self._newest = settled_torque(0.0, variation)
        self.settled_torque = self._newest
        """Torque in N m that the brake approaches now."""

    def command(self, time_s: float, duty: float) -> None:
        """Put `duty` (0..1) at the terminals."""
        settled = settled_torque(duty, self._variation)
        if settled != self._newest:
            self._newest = settled
            self._coming.append((time_s + self._variation.brake_dead_time_s, settled))

    def move_to(self, time_s: float) -> float:
        """Apply the commands that act by `time_s`; return the time in s of the next one, or infinity."""
        coming = self._coming
        while coming and coming[0][0] <= time_s + SAME_TIME_S:
            self.settled_torque = coming.popleft()[1]
        return coming[0][0] if coming else math.inf
