"""Rigs and their states as rows of arrays, for the compiled kernel: every name as in the scalar plant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inteco_abs.rig import DriveMotor, EncoderVariation, RigParameters, RigVariation, noise_seed, plant, settled_torque
from inteco_abs.rig import adhesion_curve as surface
from inteco_abs.rig import brake_actuator as varied_brake

Rows = NDArray[np.void]

_DISC: Final = np.dtype([(field.name, np.float64) for field in fields(EncoderVariation)])
_PARAMETERS: Final = [field.name for field in fields(RigParameters)]
_OWN: Final = [
    field.name
    for field in fields(RigVariation)
    if field.name not in {"parameters", "brake_map", "wheel_encoder", "road_encoder", "command_delay_ticks", "seed"}
]
RIG: Final = np.dtype(
    [(name, np.float64) for name in ("stall_torque_nm", "no_load_speed_rad_s", "L_sin", "L_cos", *_PARAMETERS, *_OWN)]
    + [(f"{wheel}_{name}", np.float64) for wheel in ("wheel", "road") for name in _DISC.names or ()]
    + [("measured_map", np.bool_), ("published_formula", np.bool_)]
    + [("command_delay_ticks", np.int64), ("noise_seed", np.uint64)],
    align=True,
)
"""One rig and its motor. `published_formula`: its equation (8) is that of the measured curve's rise."""

STATE: Final = np.dtype(
    [
        (name, np.float64)
        for name in (
            *("wheel_speed", "road_speed", "brake_torque", "wheel_angle", "road_angle", "time_s"),
            *("settled_torque", "newest_torque", "braking_since_s", "grip", "L_sin", "L_cos"),
            *("lag_step_s", "lag_left", "lag_mean"),
        )
    ]
    + [("coming", np.int64)],
    align=True,
)
"""Where one rig is. `coming` commands are on their way to the brake; `lag_*` belong to a step of `lag_step_s`."""

_FORMULA: Final = ("w1", "w2", "w3", "w4", "a", "p")
_FIXED: Final = {
    "gamma": plant.GAMMA,
    "contact_rate": plant.CONTACT_RATE,
    "stiff": plant.STIFF,
    "followed": plant.FOLLOWED,
    "most_cuts": plant.MOST_CUTS,
    "almost_at_rest": plant.ALMOST_AT_REST,
    "crawl_rad_s": plant.CRAWL_RAD_S,
    "same_time_s": varied_brake.SAME_TIME_S,
    "exact": varied_brake.EXACT,
    "rise_end": surface.RISE_END,
    "rise": surface.RISE,
    **{name: getattr(RigParameters.named("mask"), name) for name in _FORMULA},
}
FIXED: Final = np.dtype(
    [(name, np.float64) for name in (*_FIXED, "max_step_s")]
    + [("cubics", np.float64, np.shape(surface.MEASURED_CUBICS))]
    + [("torques", np.float64, np.shape(varied_brake.MEASURED_TORQUE))]
)
"""What is the same for all rigs: the integrator's constants and the measured curves, with the formula of the rise."""


def fixed_row(max_step_s: float) -> Rows:
    """The one row of type FIXED."""
    values = (*_FIXED.values(), max_step_s, surface.MEASURED_CUBICS, varied_brake.MEASURED_TORQUE)
    return np.array([values], FIXED).view(np.recarray)


def rig_rows(variations: Sequence[RigVariation], motors: Sequence[DriveMotor]) -> Rows:
    """One row of type RIG for each variation and its motor."""
    published = RigParameters.named("mask")

    def row(rig: RigVariation, motor: DriveMotor) -> tuple[Any, ...]:
        k = rig.parameters
        return (
            motor.stall_torque_nm,
            motor.no_load_speed_rad_s,
            k.L * math.sin(k.phi_rad),
            k.L * math.cos(k.phi_rad),
            *astuple(k),
            *(getattr(rig, name) for name in _OWN),
            *astuple(rig.wheel_encoder),
            *astuple(rig.road_encoder),
            rig.brake_map == "measured",
            all(getattr(k, name) == getattr(published, name) for name in _FORMULA),
            rig.command_delay_ticks,
            noise_seed(rig),
        )

    return np.array([row(rig, motor) for rig, motor in zip(variations, motors, strict=True)], RIG).view(np.recarray)


def state_rows(
    variations: Sequence[RigVariation],
    rigs: Rows,
    wheel_speed: float | NDArray[np.float64],
    road_speed: float | NDArray[np.float64],
) -> Rows:
    """Rows of type STATE, at the given speeds in rad/s with the brake released."""
    states = np.zeros(len(variations), STATE).view(np.recarray)
    states["wheel_speed"], states["road_speed"] = wheel_speed, road_speed
    states["settled_torque"] = states["newest_torque"] = [settled_torque(0.0, rig) for rig in variations]
    states["braking_since_s"] = math.inf
    states["grip"] = 1.0
    states["L_sin"], states["L_cos"] = rigs["L_sin"], rigs["L_cos"]
    states["lag_step_s"] = math.nan
    return states
