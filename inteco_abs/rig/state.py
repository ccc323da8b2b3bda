"""What the plant's functions work on: the constants of one rig, and where it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from inteco_abs import elementary
from inteco_abs.rig.actuators import DriveMotor
from inteco_abs.rig.encoder import noise_seed
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.rng import Word
from inteco_abs.rig.variation import EncoderVariation, RigVariation


@dataclass(frozen=True, slots=True)
class Constants(RigParameters):
    """One rig and its motor, flat: the fields of `RigVariation` and `DriveMotor` under their names."""

    adhesion_scale: float
    adhesion_blend: float
    brake_gain: float
    brake_duty_offset: float
    brake_dead_time_s: float
    brake_duty_cap: float
    brake_pwm_steps: int
    load_ripple: float
    load_ripple_phase_rad: float
    grip_step: float
    grip_step_after_s: float
    wheel_encoder: EncoderVariation
    road_encoder: EncoderVariation
    command_delay_ticks: int
    stall_torque_nm: float
    no_load_speed_rad_s: float
    max_step_s: float
    L_sin: float
    """Lever's length times the sine of its angle, m."""
    L_cos: float
    measured_map: bool
    noise_seed: Word
    plain: bool
    """Whether commands act at once and the adhesion has no step, as in `RigVariation.plain_plant`."""

    @staticmethod
    def of(rig: RigVariation, motor: DriveMotor | None = None, max_step_s: float = 0.0005) -> Constants:
        """The rig's constants."""
        k, motor = rig.parameters, motor or DriveMotor()
        sine, cosine = elementary.sin_cos(k.phi_rad)
        return Constants(
            **{name: getattr(k, name) for name in _PARAMETERS},
            **{name: getattr(rig, name) for name in _OWN},
            stall_torque_nm=motor.stall_torque_nm,
            no_load_speed_rad_s=motor.no_load_speed_rad_s,
            max_step_s=max_step_s,
            L_sin=k.L * sine,
            L_cos=k.L * cosine,
            measured_map=rig.brake_map == "measured",
            noise_seed=noise_seed(rig),
            plain=rig.plain_plant,
        )


_PARAMETERS = tuple(field.name for field in fields(RigParameters))
_OWN = tuple(field.name for field in fields(RigVariation) if field.name in Constants.__slots__)


@dataclass(slots=True)
class State:
    """State of one rig: speeds in rad/s, angles in rad, torques in N m."""

    wheel_speed: float
    road_speed: float
    L_sin: float
    """Lever times sine of its angle under the present load, m; `L_cos` times the cosine."""
    L_cos: float
    grip: float
    """Factor on the adhesion: the rig's own, which the road may change during a stop."""
    settled_torque: float = 0.0
    """Torque that the brake approaches now."""
    newest_torque: float = 0.0
    """Torque that the brake will approach once the newest command acts."""
    newest_duty: float = 0.0
    brake_torque: float = 0.0
    """Torque that the brake can hold."""
    wheel_angle: float = 0.0
    road_angle: float = 0.0
    time_s: float = 0.0
    braking_since_s: float = math.inf
    lag_step_s: float = math.nan
    """Step that the two following ones belong to."""
    lag_left: float = 0.0
    """Share of the brake's distance to its target after the step."""
    lag_mean: float = 0.0
    """Its mean over the step."""
    sent: int = 0
    """Commands that went to the brake with a dead time."""
    arrived: int = 0
    """Number of these commands that act already."""
