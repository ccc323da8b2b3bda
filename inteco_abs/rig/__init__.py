"""The physics of the rig, pure: published parameters, friction, actuators and the plant in all its regimes."""

from inteco_abs.rig.actuators import DriveMotor, brake_duty, brake_torque
from inteco_abs.rig.friction import adhesion, adhesion_slope
from inteco_abs.rig.model import Motion, accelerations, kinetic_energy, wheel_slip
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.plant import Plant

__all__ = [
    "DriveMotor",
    "Motion",
    "Plant",
    "RigParameters",
    "accelerations",
    "adhesion",
    "adhesion_slope",
    "brake_duty",
    "brake_torque",
    "kinetic_energy",
    "wheel_slip",
]
