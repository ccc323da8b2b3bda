"""What the plant's functions work on: the constants of one rig, and where it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from inteco_abs import elementary
from inteco_abs.rig.actuators import DriveMotor
from inteco_abs.rig.encoder import noise_seed
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.rng import Word
from inteco_abs.rig.variation import ROADS, EncoderVariation, RigVariation


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
    second_grip_step: float
    second_grip_step_after_s: float
    third_grip_step: float
    third_grip_step_after_s: float
    adhesion_tilt: float
    later_road_after_s: float
    brake_release_ratio: float
    brake_release_delay_s: float
    brake_hysteresis_nm: float
    brake_fade_per_kj: float
    wheel_wear_per_kj: float
    supply_sag: float
    drive_residual_nm: float
    latch_jitter_s: float
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
    road_c1: float
    """Coefficients of the road, as in `ROADS`; 0 for the rig's own curve."""
    road_c2: float
    road_c3: float
    later_c1: float
    """Those of the later road; 0 for none."""
    later_c2: float
    later_c3: float
    road_changes: bool
    """Whether the adhesion may step, or the road change, during a stop."""
    plain_curve: bool
    """Whether the adhesion curve is that of equation (8)."""
    contact_rate: float
    """Largest contact eigenvalue times the speed, rad/s2."""

    @staticmethod
    def of(rig: RigVariation, motor: DriveMotor | None = None, max_step_s: float = 0.0005) -> Constants:
        """The rig's constants."""
        k, motor = rig.parameters, motor or DriveMotor()
        sine, cosine = elementary.sin_cos(k.phi_rad)
        road, later = ROADS[rig.road], ROADS[rig.later_road]
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
            road_c1=road[0],
            road_c2=road[1],
            road_c3=road[2],
            later_c1=later[0],
            later_c2=later[1],
            later_c3=later[2],
            road_changes=any(getattr(rig, name) for name in _CHANGES),
            plain_curve=not (rig.adhesion_blend or rig.adhesion_tilt or rig.road or rig.later_road),
            contact_rate=contact_rate(road[0] * road[1], later[0] * later[1]),
        )


def contact_rate(road_slope: float, later_slope: float) -> float:
    """Largest contact eigenvalue times the speed, rad/s2, with roads of these slopes of the adhesion at zero slip.

    It is 15.6e3 for both published sets, whose curve has a slope of at most 13.8.
    """
    return 15.6e3 * max(1.0, road_slope / 13.8, later_slope / 13.8)


_CHANGES = (
    *("grip_step", "grip_step_after_s", "second_grip_step_after_s", "third_grip_step_after_s"),
    *("later_road", "later_road_after_s"),
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
    wheel_radius: float
    """Radius of the upper wheel, which wears, m."""
    road_c1: float
    """Coefficients of the road's adhesion, as in `ROADS`; 0 for the rig's own curve."""
    road_c2: float
    road_c3: float
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
    cold_torque: float = 0.0
    """Torque that a cold brake would approach now."""
    fade: float = 1.0
    """Share of it that the hot brake has."""
    brake_work_kj: float = 0.0

    @staticmethod
    def at_speeds(k: Constants, wheel_speed: float, road_speed: float, released_nm: float = 0.0) -> State:
        """The state of a rig at these speeds in rad/s, with a brake that settles to `released_nm`."""
        state = State(wheel_speed, road_speed, *start_values(k), released_nm, released_nm)
        state.cold_torque = released_nm
        return state


def start_values(k: Constants) -> tuple[float, float, float, float, float, float, float]:
    """Values of the fields of `State` that follow the speeds and have no default."""
    return k.L_sin, k.L_cos, k.adhesion_scale, k.r1, k.road_c1, k.road_c2, k.road_c3
