"""Whether a rig's brake can hold a slip: the torque that this takes, and what the brake has."""

from __future__ import annotations

from typing import Final

from inteco_abs.rig.adhesion_curve import AdhesionCurve
from inteco_abs.rig.brake_actuator import settled_torque
from inteco_abs.rig.model import Model
from inteco_abs.rig.variation import RigVariation

_SPEEDS_RAD_S: Final = (10.0, 180.0)
"""Where slip is controlled: from the end of what is measured to the start of braking."""
_PROBE_NM: Final = 1.0


def holding_torque(variation: RigVariation, slip: float, road_speed: float) -> float:
    """Brake torque in N m that keeps `slip` (0..1, both excluded) at `road_speed` > 0 rad/s, drive off.

    From this rig's own contact, without its ripple and steps: both rim speeds fall in proportion, and the model is
    affine in the torque. Negative where even a released brake slows the wheel too much.
    """
    if not (0.0 < slip < 1.0 and road_speed > 0.0):
        raise ValueError(f"slip {slip!r}, road speed {road_speed!r} rad/s: must be within 0..1, and above 0")
    k = variation.parameters
    model = Model(k, AdhesionCurve(variation.adhesion_scale, variation.adhesion_blend))
    rim_ratio = (1.0 - slip) * k.r2 / k.r1

    def excess(torque: float) -> float:
        """By how much the wheel slows down more slowly than this slip takes, rad/s2."""
        wheel, road, *_ = model.rates(rim_ratio * road_speed, road_speed, torque, 0.0)
        return wheel - rim_ratio * road

    released = excess(0.0)
    return released * _PROBE_NM / (released - excess(_PROBE_NM))


def torque_margin(variation: RigVariation, slip: float = 0.2) -> float:
    """Torque in N m that the fully driven brake has beyond what holds `slip`, at the speed where that is least.

    Over road speeds from 10 to 180 rad/s, at one end of which it is, because it is affine in the speed. Negative
    where the brake cannot hold the slip.
    """
    needed = max(holding_torque(variation, slip, speed) for speed in _SPEEDS_RAD_S)
    return settled_torque(1.0, variation) - needed
