"""Named populations of virtual rigs, each draw reproducible from its seed.

nominal  what the paper assumes: the published rig with a brake without lag, ideal encoders of 2048 counts
hard     a realistic rig. Within 5 %: J1, J2, Mg and the gain of the brake's measured map, which is off by up to
         0.02 of duty; within 20 %: d1 and d2; adhesion within 15 % and anywhere between equation (8) and the measured
         curve; brake lag 35..65 ms after a dead time of 5..15 ms; 8-bit PWM; 2048 counts that sit off centre by half
         a count and jitter by 0.3 (standard deviation); a tick of delay
rough    hard, and the normal force ripples by 0..3 % once per turn of the wheel; in half of the draws the road's force,
         by its adhesion, steps by up to 20 %, up or down, 0.2..0.7 s after braking began, in the first half of a stop
late     rough with that step in all draws and 0.7..1 s after braking began, when 1/speed has made the slip quick
slow     hard, with 20 ms of dead time
capped   hard, with the duty capped at 0.7 as by the vendor's driver, which leaves some rigs too little torque

One seed is one rig: `hard`, `slow`, `capped` and `rough` of a seed differ only in what is named here, so populations
can be compared draw by draw.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.rng import SplitMix64, mixed
from inteco_abs.rig.variation import EncoderVariation, RigVariation

_TURN: Final = 2.0 * math.pi
_COUNTS: Final = 2048
LONGEST_BRAKING_S: Final = 4.0
"""No rig of any population that is braked at all takes half as long."""


def draw(population: str, seed: int) -> RigVariation:
    """Rig number `seed` (0..2^64-1) of a population, by SplitMix64; raises ValueError for any other.

    Every number is evenly spread over its range and independent of the others.
    """
    try:
        make = _MAKERS[population]
    except KeyError:
        raise ValueError(f"population {population!r}: must be one of {', '.join(_MAKERS)}") from None
    return make(seed)


def _nominal(seed: int) -> RigVariation:
    _generator(seed)  # checks the seed, which decides nothing
    parameters = replace(RigParameters.named("mask"), c31=math.inf)
    disc = EncoderVariation(_COUNTS)
    return RigVariation(parameters, wheel_encoder=disc, road_encoder=disc, seed=seed)


def _hard(seed: int) -> RigVariation:
    return _hard_from(_generator(seed), seed)


def _rough(seed: int) -> RigVariation:
    return _rough_road(seed, share=0.5, from_s=0.2, until_s=0.7)  # reaching is over, and a stop takes 1.3 s


def _late(seed: int) -> RigVariation:
    return _rough_road(seed, share=1.0, from_s=0.7, until_s=1.0)


def _rough_road(seed: int, share: float, from_s: float, until_s: float) -> RigVariation:
    """A hard rig with ripple, and in a `share` of the draws with a step."""
    generator = _generator(seed)
    rig = _hard_from(generator, seed)
    uniform = generator.uniform
    steps = uniform(0.0, 1.0) < share
    return replace(
        rig,
        load_ripple=uniform(0.0, 0.03),
        load_ripple_phase_rad=uniform(0.0, _TURN),
        grip_step=uniform(-0.2, 0.2) * steps,
        grip_step_after_s=uniform(from_s, until_s) * steps,
    )


def _slow(seed: int) -> RigVariation:
    return replace(_hard(seed), brake_dead_time_s=0.020)


def _capped(seed: int) -> RigVariation:
    return replace(_hard(seed), brake_duty_cap=0.7)


def _generator(seed: int) -> SplitMix64:
    return SplitMix64(mixed(SplitMix64(seed).word()))  # neighbouring seeds begin far from each other


def _hard_from(generator: SplitMix64, seed: int) -> RigVariation:
    uniform, k = generator.uniform, RigParameters.named("mask")
    parameters = replace(
        k,
        J1=k.J1 * uniform(0.95, 1.05),
        J2=k.J2 * uniform(0.95, 1.05),
        Mg=k.Mg * uniform(0.95, 1.05),
        d1=k.d1 * uniform(0.8, 1.2),
        d2=k.d2 * uniform(0.8, 1.2),
        c31=1.0 / uniform(0.035, 0.065),
    )
    return RigVariation(
        parameters,
        adhesion_scale=uniform(0.85, 1.15),
        adhesion_blend=uniform(0.0, 1.0),
        brake_map="measured",
        brake_gain=uniform(0.95, 1.05),
        brake_duty_offset=uniform(-0.02, 0.02),
        brake_dead_time_s=uniform(0.005, 0.015),
        brake_pwm_steps=255,
        wheel_encoder=_disc(generator),
        road_encoder=_disc(generator),
        command_delay_ticks=1,
        seed=seed,
    )


def _disc(generator: SplitMix64) -> EncoderVariation:
    uniform = generator.uniform
    return EncoderVariation(
        _COUNTS,
        edge_counts=uniform(0.0, 1.0),
        eccentricity_counts=0.5,
        eccentricity_phase_rad=uniform(0.0, _TURN),
        jitter_counts=0.3,
    )


_MAKERS: Final[dict[str, Callable[[int], RigVariation]]] = {
    "nominal": _nominal,
    "hard": _hard,
    "rough": _rough,
    "late": _late,
    "slow": _slow,
    "capped": _capped,
}
POPULATIONS: Final = tuple(_MAKERS)
"""Names of the populations."""
