"""The differences of one rig from the published one, as one value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from inteco_abs.rig.parameters import RigParameters

LONGEST_DEAD_TIME_S: Final = 0.2
"""Longest dead time of a rig's brake."""
MOST_DELAY_TICKS: Final = 8
"""From a sample to its command."""
ROADS: Final[dict[str, tuple[float, float, float]]] = {
    "": (0.0, 0.0, 0.0),
    "dry-asphalt": (1.2801, 23.99, 0.52),
    "dry-concrete": (1.1973, 25.168, 0.5373),
    "wet-asphalt": (0.857, 33.822, 0.347),
    "wet-cobblestone": (0.4004, 33.708, 0.1204),
    "snow": (0.1946, 94.129, 0.0646),
    "ice": (0.05, 306.39, 0.0),
}
"""Coefficients c1, c2, c3 of the adhesion c1 * (1 - exp(-c2 * slip)) - c3 * slip of roads; none for the rig's own.

M. Burckhardt, Fahrwerktechnik: Radschlupf-Regelsysteme, Vogel, 1993.
"""
_ANY: Final = (-math.inf, math.inf)
ENCODER_RANGES: Final = {
    "counts_per_turn": (16, 1_000_000),
    "edge_counts": (0.0, 1.0),
    "eccentricity_counts": (0.0, 100.0),
    "eccentricity_phase_rad": _ANY,
    "jitter_counts": (0.0, 10.0),
    "second_harmonic_counts": (0.0, 100.0),
    "second_harmonic_phase_rad": _ANY,
    "damaged_counts": (0.0, 8.0),
    "damage_angle_rad": _ANY,
    "lost_share": (0.0, 0.05),
}
RIG_RANGES: Final = {
    "adhesion_scale": (0.1, 2.0),
    "adhesion_blend": (0.0, 1.0),
    "brake_gain": (0.1, 3.0),
    "brake_duty_offset": (-0.2, 0.2),
    "brake_dead_time_s": (0.0, LONGEST_DEAD_TIME_S),
    "brake_duty_cap": (0.1, 1.0),
    "brake_pwm_steps": (0, 65535),
    "load_ripple": (0.0, 0.5),
    "load_ripple_phase_rad": _ANY,
    "grip_step": (-0.9, 1.0),
    "grip_step_after_s": (0.0, 60.0),
    "second_grip_step": (-0.9, 1.0),
    "second_grip_step_after_s": (0.0, 60.0),
    "third_grip_step": (-0.9, 1.0),
    "third_grip_step_after_s": (0.0, 60.0),
    "adhesion_tilt": (-1.0, 1.0),
    "later_road_after_s": (0.0, 60.0),
    "brake_release_ratio": (0.1, 10.0),
    "brake_release_delay_s": (-LONGEST_DEAD_TIME_S, LONGEST_DEAD_TIME_S),
    "brake_hysteresis_nm": (0.0, 2.0),
    "brake_fade_per_kj": (0.0, 5.0),
    "wheel_wear_per_kj": (0.0, 0.1),
    "supply_sag": (0.0, 0.5),
    "drive_residual_nm": (0.0, 0.09),
    "latch_jitter_s": (0.0, 0.001),
    "command_delay_ticks": (0, MOST_DELAY_TICKS),
    "seed": (0, (1 << 64) - 1),
}


def _require_ranges(record: object, ranges: Mapping[str, tuple[float, float]]) -> None:
    for name, (low, high) in ranges.items():
        value = getattr(record, name)
        if not (low <= value <= high and math.isfinite(value)):
            allowed = f"must be in {low:g}..{high:g}" if low > -math.inf else "must be finite"
            raise ValueError(f"{name} = {value!r}: {allowed}")


@dataclass(frozen=True, slots=True)
class EncoderVariation:
    """One wheel's encoder; by default an ideal disc, whose counter changes exactly at each line."""

    counts_per_turn: int = 2048
    """Quadrature counts, 16..1e6: 2048 in the paper, 4096 on the vendor's rig. The counter rounds down."""
    edge_counts: float = 0.0
    """Position between two lines at angle 0, in counts, 0..1."""
    eccentricity_counts: float = 0.0
    """Amplitude of the error of a disc off centre, in counts, 0..100; once per turn."""
    eccentricity_phase_rad: float = 0.0
    """Phase of that error, any angle."""
    jitter_counts: float = 0.0
    """Standard deviation of the normal noise of each reading, in counts, 0..10."""
    second_harmonic_counts: float = 0.0
    """Amplitude of an error of the disc twice per turn, as of a bent one, in counts, 0..100."""
    second_harmonic_phase_rad: float = 0.0
    """Phase of that error at angle 0, any angle."""
    damaged_counts: float = 0.0
    """Counts that are missing in each turn, as at a damaged line, 0..8."""
    damage_angle_rad: float = 0.0
    """Angle of the wheel at which they are missing, any angle."""
    lost_share: float = 0.0
    """Share of all counts that the board misses, at irregular places, 0..0.05."""

    def __post_init__(self) -> None:
        _require_ranges(self, ENCODER_RANGES)


@dataclass(frozen=True, slots=True)
class RigVariation:
    """One rig; the defaults are the published rig's, bit for bit. Raises ValueError for a value out of range."""

    parameters: RigParameters = field(default_factory=lambda: RigParameters.named("mask"))
    """Masses, frictions, lengths, equation (8), the brake's straight line and its lag c31."""
    adhesion_scale: float = 1.0
    """Factor on the adhesion, 0.1..2."""
    adhesion_blend: float = 0.0
    """Share of the measured adhesion curve in 0..1; the rest is equation (8)."""
    brake_map: Literal["line", "measured"] = "line"
    """Static map from duty to torque: the straight line of `parameters`, or the points measured in the manual."""
    brake_gain: float = 1.0
    """Factor on the static map's torque, 0.1..3."""
    brake_duty_offset: float = 0.0
    """Duty that the static map needs beyond the published one for the same torque, -0.2..0.2."""
    brake_dead_time_s: float = 0.0
    """Dead time of the brake, 0..0.2 s; the lag c31 comes on top."""
    brake_duty_cap: float = 1.0
    """Largest duty that the amplifier lets through, 0.1..1."""
    brake_pwm_steps: int = 0
    """Steps from duty 0 to 1: 255 for 8 bit, 4095 for 12 bit, rounded down to one; 0 for a continuous output."""
    load_ripple: float = 0.0
    """Amplitude of the normal force's ripple over a turn of the wheel, as a share of the force, 0..0.5."""
    load_ripple_phase_rad: float = 0.0
    """Phase of the ripple in the wheel's angle, any angle."""
    grip_step: float = 0.0
    """Step of the road's adhesion during a stop, as a share of it, -0.9..1."""
    grip_step_after_s: float = 0.0
    """Time of the step since the first brake command without drive, 0..60 s; it ends with the next drive."""
    second_grip_step: float = 0.0
    """As `grip_step`, of a second step; of all whose time has come, the latest holds."""
    second_grip_step_after_s: float = 0.0
    """Time of that step as of the first one, 0..60 s; 0 for none."""
    third_grip_step: float = 0.0
    """Adhesion from a third step on, in the same way."""
    third_grip_step_after_s: float = 0.0
    """Time of that step, 0..60 s; 0 for none."""
    adhesion_tilt: float = 0.0
    """Slope of the adhesion over slip beyond the curve's own: a factor of 1 + tilt * (slip - 0.2), -1..1."""
    road: str = ""
    """Road of `ROADS` in place of the rig's own adhesion curve; empty for that. Scale, steps and tilt apply to it."""
    later_road: str = ""
    """Road on which a stop continues, or empty."""
    later_road_after_s: float = 0.0
    """Time of that change since the first brake command without drive, 0..60 s."""
    brake_release_ratio: float = 1.0
    """The brake's lag while its torque falls, over c31's while it rises, 0.1..10."""
    brake_release_delay_s: float = 0.0
    """How much longer the dead time of a falling torque is than that of a rising one, -0.2..0.2 s; the sum is limited
    to 0..0.2 s. A command that acts earlier than those before it replaces them."""
    brake_hysteresis_nm: float = 0.0
    """Width of the static map's hysteresis, by friction in the brake's lever, 0..2 N m; without a duty it opens."""
    brake_fade_per_kj: float = 0.0
    """Fade with heat, 0..5: after a work of E kJ the torque is 1 / (1 + fade * E) of the cold brake's. It stays hot."""
    wheel_wear_per_kj: float = 0.0
    """Share of the wheel's radius that is lost for each kJ of work in the brake, 0..0.1."""
    supply_sag: float = 0.0
    """Share by which the brake's supply falls at full duty, 0..0.5; in proportion at less."""
    drive_residual_nm: float = 0.0
    """Torque of the drive without a duty, 0..0.09 N m, less than the road's static friction."""
    latch_jitter_s: float = 0.0
    """Largest time between a time stamp and its counts, before or after it, of both wheels, 0..0.001 s."""
    wheel_encoder: EncoderVariation = EncoderVariation()
    road_encoder: EncoderVariation = EncoderVariation()
    command_delay_ticks: int = 0
    """Ticks from a sample to the output of its command, 0..8. It belongs to the loop: `Plant` leaves it to its caller
    (a loop that writes before it reads has one), `BatchPlant` applies it."""
    seed: int = 0
    """Seed of the encoders' noise, 0..2^64-1."""

    def __post_init__(self) -> None:
        _require_ranges(self, RIG_RANGES)
        if self.brake_map not in {"line", "measured"}:
            raise ValueError(f"brake_map = {self.brake_map!r}: must be 'line' or 'measured'")
        for name in ("road", "later_road"):
            if getattr(self, name) not in ROADS:
                raise ValueError(f"{name} = {getattr(self, name)!r}: must be one of {', '.join(map(repr, ROADS))}")

    @property
    def plain_plant(self) -> bool:
        """Whether wheels, contact and brake depend on `parameters` alone."""
        return all(getattr(self, name) == value for name, value in _PLAIN.items())


_PLAIN: Final[dict[str, object]] = {
    "adhesion_scale": 1.0,
    "adhesion_blend": 0.0,
    "brake_map": "line",
    "brake_gain": 1.0,
    "brake_duty_offset": 0.0,
    "brake_dead_time_s": 0.0,
    "brake_duty_cap": 1.0,
    "brake_pwm_steps": 0,
    "load_ripple": 0.0,
    "grip_step": 0.0,
    "second_grip_step_after_s": 0.0,
    "third_grip_step_after_s": 0.0,
    "adhesion_tilt": 0.0,
    "road": "",
    "later_road": "",
    "brake_release_ratio": 1.0,
    "brake_release_delay_s": 0.0,
    "brake_hysteresis_nm": 0.0,
    "brake_fade_per_kj": 0.0,
    "wheel_wear_per_kj": 0.0,
    "supply_sag": 0.0,
    "drive_residual_nm": 0.0,
}
