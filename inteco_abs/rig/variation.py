"""What one rig may have of its own: everything in which it differs from the published one, as one value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

from inteco_abs.rig.parameters import RigParameters

_ANY: Final = (-math.inf, math.inf)
_ENCODER_RANGES: Final = {
    "counts_per_turn": (16, 1_000_000),
    "edge_counts": (0.0, 1.0),
    "eccentricity_counts": (0.0, 100.0),
    "eccentricity_phase_rad": _ANY,
    "jitter_counts": (0.0, 10.0),
}
_RIG_RANGES: Final = {
    "adhesion_scale": (0.1, 2.0),
    "adhesion_blend": (0.0, 1.0),
    "brake_gain": (0.1, 3.0),
    "brake_duty_offset": (-0.2, 0.2),
    "brake_dead_time_s": (0.0, 0.2),
    "brake_duty_cap": (0.1, 1.0),
    "brake_pwm_steps": (0, 65535),
    "load_ripple": (0.0, 0.5),
    "load_ripple_phase_rad": _ANY,
    "grip_step": (-0.9, 1.0),
    "grip_step_after_s": (0.0, 60.0),
    "command_delay_ticks": (0, 8),
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
    """One wheel's encoder. The defaults: an ideal disc, whose counter changes exactly at each line."""

    counts_per_turn: int = 2048
    """Quadrature counts, 16..1e6: 2048 in the paper, 4096 on the vendor's rig. The counter rounds down."""
    edge_counts: float = 0.0
    """Where between two lines the wheel stands at angle 0, in counts, 0..1."""
    eccentricity_counts: float = 0.0
    """Largest error of a disc that sits off centre, in counts, 0..100; once per turn."""
    eccentricity_phase_rad: float = 0.0
    """Where in the turn that error passes through zero upwards, any angle."""
    jitter_counts: float = 0.0
    """Standard deviation of the normal noise of each reading, in counts, 0..10."""

    def __post_init__(self) -> None:
        _require_ranges(self, _ENCODER_RANGES)


@dataclass(frozen=True, slots=True)
class RigVariation:
    """One rig. Every default is the published rig's, which `Plant` and `BatchPlant` then are to the last digit.

    Raises ValueError for a value out of its range.
    """

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
    """How much more duty the static map takes for the same torque, -0.2..0.2."""
    brake_dead_time_s: float = 0.0
    """Pure delay of the brake behind its terminals, 0..0.2 s; c31 comes on top."""
    brake_duty_cap: float = 1.0
    """Largest duty that the amplifier lets through, 0.1..1."""
    brake_pwm_steps: int = 0
    """Steps from duty 0 to 1: 255 for 8 bit, 4095 for 12 bit, rounded down to one; 0 for a continuous output."""
    load_ripple: float = 0.0
    """Amplitude of the normal force over a turn of the wheel, as a share of it, 0..0.5."""
    load_ripple_phase_rad: float = 0.0
    """Phase of that in the wheel's angle, at which the force is its mean and rises; any angle."""
    grip_step: float = 0.0
    """Step of the road's adhesion during a stop, as a share of it, -0.9..1."""
    grip_step_after_s: float = 0.0
    """When the step comes, from the first command of brake without drive on, 0..60 s; it ends with the next drive."""
    wheel_encoder: EncoderVariation = EncoderVariation()
    road_encoder: EncoderVariation = EncoderVariation()
    command_delay_ticks: int = 0
    """Ticks from the sample to the output of the command that it led to, 0..8. It is the loop's, not the rig's:
    `Plant` leaves it to its caller (a loop that writes before it reads has one), `BatchPlant` applies it."""
    seed: int = 0
    """What the encoders' noise is made from, 0..2^64-1."""

    def __post_init__(self) -> None:
        _require_ranges(self, _RIG_RANGES)
        if self.brake_map not in {"line", "measured"}:
            raise ValueError(f"brake_map = {self.brake_map!r}: must be 'line' or 'measured'")

    @property
    def plain_plant(self) -> bool:
        """Whether wheels, contact and brake are those of the model, so that only `parameters` matter to them."""
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
