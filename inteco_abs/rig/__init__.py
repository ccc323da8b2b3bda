"""The physics of the rig, pure: parameters, friction, actuators, the plant in all regimes, populations of rigs."""

from inteco_abs.rig.actuators import DriveMotor, brake_duty, brake_torque
from inteco_abs.rig.adhesion_curve import AdhesionCurve, measured_adhesion, measured_adhesion_slope
from inteco_abs.rig.brake_actuator import MEASURED_MAP, measured_duty, measured_torque, settled_torque
from inteco_abs.rig.brake_map import BrakeMap
from inteco_abs.rig.description import described
from inteco_abs.rig.encoder import Encoder, noise_seed
from inteco_abs.rig.friction import adhesion, adhesion_slope
from inteco_abs.rig.model import Motion, accelerations, kinetic_energy, wheel_slip
from inteco_abs.rig.nominal import nominal_brake_map, nominal_drive_motor, nominal_parameters
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.plant import Plant
from inteco_abs.rig.population import LONGEST_BRAKING_S, POPULATIONS, draw, is_described
from inteco_abs.rig.rng import WORD, mixed
from inteco_abs.rig.roads import on_road
from inteco_abs.rig.torque_margin import holding_torque, torque_margin
from inteco_abs.rig.variation import (
    ENCODER_RANGES,
    LONGEST_DEAD_TIME_S,
    MOST_DELAY_TICKS,
    RIG_RANGES,
    ROADS,
    EncoderVariation,
    RigVariation,
)

__all__ = [
    "ENCODER_RANGES",
    "LONGEST_BRAKING_S",
    "LONGEST_DEAD_TIME_S",
    "MEASURED_MAP",
    "MOST_DELAY_TICKS",
    "POPULATIONS",
    "RIG_RANGES",
    "ROADS",
    "WORD",
    "AdhesionCurve",
    "BrakeMap",
    "DriveMotor",
    "Encoder",
    "EncoderVariation",
    "Motion",
    "Plant",
    "RigParameters",
    "RigVariation",
    "accelerations",
    "adhesion",
    "adhesion_slope",
    "brake_duty",
    "brake_torque",
    "described",
    "draw",
    "holding_torque",
    "is_described",
    "kinetic_energy",
    "measured_adhesion",
    "measured_adhesion_slope",
    "measured_duty",
    "measured_torque",
    "mixed",
    "noise_seed",
    "nominal_brake_map",
    "nominal_drive_motor",
    "nominal_parameters",
    "on_road",
    "settled_torque",
    "torque_margin",
    "wheel_slip",
]
