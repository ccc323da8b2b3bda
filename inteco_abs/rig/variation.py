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
_ANY: Final = (-math.inf, math.inf)
ENCODER_RANGES: Final = {
    "counts_per_turn": (16, 1_000_000),
    "edge_counts": (0.0, 1.0),
    "eccentricity_counts": (0.0, 100.0),
    "eccentricity_phase_rad": _ANY,
    "jitter_counts": (0.0, 10.0),
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
}
