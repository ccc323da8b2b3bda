"""Units and meanings of a rig's numbers, by the names of its dataclasses' fields."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, Final, NamedTuple

from inteco_abs.quantities import Quantity, field_meanings

_UNITS: Final = {
    name: unit
    for unit, names in {
        "m": "r1 r2 L",
        "s": "brake_dead_time_s grip_step_after_s second_grip_step_after_s third_grip_step_after_s later_road_after_s "
        "latch_jitter_s brake_release_delay_s",
        "1/s": "c31",
        "rad": "phi_rad load_ripple_phase_rad eccentricity_phase_rad second_harmonic_phase_rad damage_angle_rad",
        "rad/s": "no_load_speed_rad_s",
        "kg.m2": "J1 J2",
        "N.m": "M10 M20 Mg b1 b2 stall_torque_nm brake_hysteresis_nm drive_residual_nm",
        "N.m.s": "d1 d2",
        "1/kJ": "brake_fade_per_kj wheel_wear_per_kj",
        "{count}": "counts_per_turn edge_counts eccentricity_counts jitter_counts second_harmonic_counts "
        "damaged_counts",
    }.items()
    for name in names.split()
}


class RigNumber(NamedTuple):
    """A field of a rig's record, and what it is."""

    quantity: Quantity
    kind: str
    """Its type as declared, such as `float`."""
    value: Any


def described(record: Any) -> Iterator[RigNumber]:
    """The fields of a rig's dataclass with unit, meaning and value; numbers without a dimension have the unit `1`."""
    meanings = field_meanings(type(record))
    for field in fields(record):
        quantity = Quantity(field.name, _UNITS.get(field.name, "1"), meanings.get(field.name, ""))
        yield RigNumber(quantity, str(field.type), getattr(record, field.name))
