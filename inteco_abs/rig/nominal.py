"""The nominal rig of controllers: a published parameter set, overridden by what a lab has identified."""

from __future__ import annotations

from dataclasses import fields, replace

from inteco_abs.config import ModelConfig
from inteco_abs.rig.actuators import DriveMotor
from inteco_abs.rig.brake_actuator import MEASURED_MAP
from inteco_abs.rig.brake_map import BrakeMap
from inteco_abs.rig.parameters import RigParameters


def nominal_parameters(model: ModelConfig) -> RigParameters:
    """The parameter set that the configuration names, overridden by [model.identified]."""
    given = model.identified.as_table()
    own = {field.name: given[field.name] for field in fields(RigParameters) if field.name in given}
    return replace(RigParameters.named(model.parameters), **own)


def nominal_brake_map(model: ModelConfig) -> BrakeMap:
    """The brake's static map: identified points, or those measured in the manual."""
    own = model.identified
    if own.brake_duties is None or own.brake_torques_nm is None:
        return MEASURED_MAP
    return BrakeMap(tuple(zip(own.brake_duties, own.brake_torques_nm, strict=True)))


def nominal_drive_motor(model: ModelConfig) -> DriveMotor | None:
    """The drive motor as the lab has identified it; None if it has not."""
    own = model.identified
    if own.drive_stall_torque_nm is None or own.drive_no_load_speed_rad_s is None:
        return None
    return DriveMotor(own.drive_stall_torque_nm, own.drive_no_load_speed_rad_s)
