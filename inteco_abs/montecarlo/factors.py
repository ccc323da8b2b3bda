"""What real rigs have, one factor at a time: the draws of a population, and the same draws with one number changed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from inteco_abs.errors import ConfigError
from inteco_abs.montecarlo.samples import SampleSet

_FACTORS: Final[dict[str, tuple[str, ...]]] = {
    "rig.brake_lag_s": ("0.0", "0.005", "0.015", "0.1"),
    "rig.brake_dead_time_s": ("0.0", "0.02", "0.035", "0.05"),
    "rig.brake_release_ratio": ("0.5", "2.0", "3.0"),
    "rig.brake_hysteresis_nm": ("0.2", "0.5"),
    "rig.brake_fade_per_kj": ("0.5", "1.0"),
    "rig.brake_gain": ("0.8", "1.2"),
    "rig.brake_duty_offset": ("-0.05", "0.05"),
    "rig.supply_sag": ("0.05", "0.1"),
    "parameters.r1": ("{ factor = 0.96 }", "{ factor = 0.99 }", "{ factor = 1.01 }", "{ factor = 1.04 }"),
    "parameters.J1": ("{ factor = 0.7 }", "{ factor = 1.3 }"),
    "rig.wheel_wear_per_kj": ("0.002", "0.01"),
    "rig.latch_jitter_s": ("0.0000625", "0.000125"),
    "encoders.eccentricity_counts": ("0.0", "2.0"),
    "encoders.second_harmonic_counts": ("0.3", "0.5"),
    "wheel_encoder.damaged_counts": ("1.0", "3.0"),
    "encoders.lost_share": ("0.0002", "0.001"),
    "rig.adhesion_scale": ("0.6", "1.4"),
    "rig.adhesion_tilt": ("-0.3", "0.3"),
    "rig.grip_step": ("-0.4", "0.5"),
    "rig.load_ripple": ("0.03", "0.05"),
    "rig.drive_residual_nm": ("0.05",),
}
_BESIDE: Final = {"rig.grip_step": "grip_step_after_s = 0.4\n"}
"""What a factor needs to have an effect."""


def one_at_a_time(draws: SampleSet) -> Iterator[SampleSet]:
    """The draws, then those of each factor and level. Raises ConfigError for a population that is not shipped."""
    if draws.text:
        raise ConfigError.of("--factors", f"{draws.name}: needs a shipped population, whose numbers it changes")
    yield draws
    for factor, levels in _FACTORS.items():
        table, _, key = factor.partition(".")
        for level in levels:
            text = f'base = "{draws.population}"\n[{table}]\n{key} = {level}\n{_BESIDE.get(factor, "")}'
            shown = level.strip("{} ").replace("factor = ", "x")
            yield SampleSet(f"{draws.population}-{key}-{shown}", draws.first, draws.last, text)
