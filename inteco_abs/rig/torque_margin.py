"""Margin of brake torque: whether a rig's brake can hold a slip."""

from __future__ import annotations

from typing import Final

from inteco_abs.rig.brake_actuator import settled
from inteco_abs.rig.model import rates
from inteco_abs.rig.state import Constants, State
from inteco_abs.rig.variation import RigVariation

_SPEEDS_RAD_S: Final = (10.0, 180.0)
"""Range in which slip is controlled: from the end of the metrics to the start of braking."""
_PROBE_NM: Final = 1.0


def holding_torque(variation: RigVariation, slip: float, road_speed: float) -> float:
    """Brake torque in N m that keeps `slip` (0..1, both excluded) at `road_speed` > 0 rad/s, drive off.

    With this rig's adhesion, without ripple and steps: both rim speeds fall in proportion, and the model is affine in
    the torque. Negative where even a released brake slows the wheel too much. Raises ValueError out of range.
    """
    _require_within(slip, road_speed)
    return _holding(Constants.of(variation), slip, road_speed)


def _require_within(slip: float, road_speed: float) -> None:
    if not (0.0 < slip < 1.0 and road_speed > 0.0):
        point = f"slip {slip!r}, road speed {road_speed!r} rad/s"
        raise ValueError(f"{point}: the slip must be above 0 and below 1, the speed above 0")


def _holding(k: Constants, slip: float, road_speed: float) -> float:
    state = State.at_speeds(k, 0.0, 0.0)
    rim_ratio = (1.0 - slip) * k.r2 / k.r1

    def excess(torque: float) -> float:
        """Wheel acceleration beyond the one that holds the slip, rad/s2."""
        wheel, road, *_ = rates(k, state, rim_ratio * road_speed, road_speed, torque, 0.0)
        return wheel - rim_ratio * road

    released = excess(0.0)
    return released * _PROBE_NM / (released - excess(_PROBE_NM))


def torque_margin(variation: RigVariation, slip: float = 0.2) -> float:
    """Least torque in N m that the brake at full duty has beyond what holds `slip`, over 10..180 rad/s.

    It is affine in the speed, so the least is at one end. Negative where the brake cannot hold the slip.
    """
    _require_within(slip, min(_SPEEDS_RAD_S))
    k = Constants.of(variation)
    return settled(k, 1.0) - max(_holding(k, slip, speed) for speed in _SPEEDS_RAD_S)
