"""Populations of virtual rigs, shipped or described in TOML, each draw reproducible from its seed.

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
wild     all that is not known of real rigs, in ranges which docs/populations.md argues: lags to 0.1 s, dead times to
         50 ms, unequal release, hysteresis, fade, a supply that sags, tyres of other radii, worse discs, lost counts,
         latching jitter, up to three steps of the road

One seed is one rig: `hard`, `slow`, `capped` and `rough` of a seed differ only in what is named here, so populations
can be compared draw by draw.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, Final

from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.population_rules import follow, parse_rules
from inteco_abs.rig.rng import SplitMix64, mixed
from inteco_abs.rig.variation import EncoderVariation, RigVariation

_TURN: Final = 2.0 * math.pi
_COUNTS: Final = 2048
PUBLISHED: Final = "published"
"""Base of a population: the published rig with ideal encoders of 2048 counts, and a tick of delay."""
WILD: Final = """\
base = "hard"

[rig]
adhesion_scale = [0.7, 1.2]
adhesion_tilt = [-0.3, 0.3]
load_ripple = [0.0, 0.03]
load_ripple_phase_rad = [0.0, 6.283185307179586]
grip_step = { range = [-0.3, 0.3], share = 0.5 }
grip_step_after_s = [0.05, 0.6]
second_grip_step = [-0.3, 0.3]
second_grip_step_after_s = { range = [0.6, 1.2], share = 0.5 }
third_grip_step = [-0.3, 0.3]
third_grip_step_after_s = { range = [1.2, 1.6], share = 0.25 }
brake_lag_s = [0.0, 0.1]
brake_dead_time_s = [0.0, 0.05]
brake_release_ratio = [0.5, 3.0]
brake_hysteresis_nm = { range = [0.0, 0.3], share = 0.5 }
brake_fade_per_kj = [0.0, 0.8]
brake_gain = [0.9, 1.1]
brake_duty_offset = [-0.03, 0.03]
supply_sag = [0.0, 0.05]
wheel_wear_per_kj = [0.0, 0.002]
drive_residual_nm = { range = [0.0, 0.05], share = 0.3 }
latch_jitter_s = [0.0, 0.000125]

[parameters]
r1 = { factor = [0.96, 1.04] }
r2 = { factor = [0.99, 1.01] }
J1 = { factor = [0.9, 1.1] }
J2 = { factor = [0.9, 1.1] }

[encoders]
eccentricity_counts = [0.0, 2.0]
second_harmonic_counts = [0.0, 0.5]
second_harmonic_phase_rad = [0.0, 6.283185307179586]
damaged_counts = { range = [1.0, 4.0], share = 0.1 }
damage_angle_rad = [0.0, 6.283185307179586]
lost_share = { range = [0.0, 0.0005], share = 0.2 }
jitter_counts = [0.0, 0.6]
"""
LONGEST_BRAKING_S: Final = 4.0
"""No rig of any population that is braked at all takes half as long."""


def draw(population: str, seed: int) -> RigVariation:
    """Rig number `seed` (0..2^64-1) of a population, by SplitMix64; raises ValueError for any other.

    The population is shipped, by its name, or is the text of one in TOML. Every number is evenly spread over its range
    and independent of the others.
    """
    return _maker(population)(seed)


def is_described(population: str) -> bool:
    """Whether this is the text of a population, not a name."""
    return "\n" in population or "=" in population


@cache
def _maker(population: str) -> Callable[[int], RigVariation]:
    if is_described(population):
        try:
            return _described(tomllib.loads(population))
        except RecursionError as error:
            raise ValueError("is nested too deeply") from error
    if population not in _MAKERS:
        raise ValueError(f"population {population!r}: must be one of {', '.join(_MAKERS)}")
    return _MAKERS[population]


def _described(tables: dict[str, Any]) -> Callable[[int], RigVariation]:
    """A base and the rules that change it; raises ValueError, which names the key."""
    base = tables.pop("base", PUBLISHED)
    if not isinstance(base, str) or base not in (PUBLISHED, *_MAKERS):
        raise ValueError(f"base = {base!r}: must be one of {', '.join((PUBLISHED, *_MAKERS))}")
    make = _published if base == PUBLISHED else _MAKERS[base]
    rules = parse_rules(tables, make(0))

    return lambda seed: follow(rules, make(seed), seed)


def _published(seed: int) -> RigVariation:
    _generator(seed)  # checks the seed, which decides the rules alone
    disc = EncoderVariation(_COUNTS)
    return RigVariation(wheel_encoder=disc, road_encoder=disc, command_delay_ticks=1, seed=seed)


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
_MAKERS["wild"] = _described(tomllib.loads(WILD))
POPULATIONS: Final = tuple(_MAKERS)
"""Names of the populations."""
