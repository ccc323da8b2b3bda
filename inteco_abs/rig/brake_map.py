"""The brake's static map as points: duty to settled torque, and back."""

from __future__ import annotations

from typing import NamedTuple

Points = tuple[tuple[float, float], ...]


def interpolated(points: Points, duty: float) -> float:
    """Torque in N m at `duty` on straight lines between `points`."""
    left = points[0]
    if duty <= left[0]:
        return left[1]
    for right in points:
        if duty < right[0]:
            return left[1] + (right[1] - left[1]) * ((duty - left[0]) / (right[0] - left[0]))
        left = right
    return left[1]


def inverse(points: Points, torque: float) -> float:
    """Duty for `torque` in N m: 0 for no torque, 1 above the largest one, NaN for NaN."""
    if torque <= 0.0:
        return 0.0
    left = points[0]
    for right in points[1:]:
        if not torque >= right[1]:
            return left[0] + (right[0] - left[0]) * ((torque - left[1]) / (right[1] - left[1]))
        left = right
    return 1.0


class BrakeMap(NamedTuple):
    """Straight lines between points of duty and torque in N m, both rising; constant beyond."""

    points: Points

    def torque(self, duty: float) -> float:
        """Settled torque in N m at `duty`."""
        return interpolated(self.points, duty)

    def duty(self, torque: float) -> float:
        """Duty for `torque` in N m: 0 for no torque, 1 above the largest one, NaN for NaN."""
        return inverse(self.points, torque)
