"""The rig at the mock board: the published one as configured, or one drawn from a population."""

from __future__ import annotations

import reprlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any, Final

from inteco_abs.config import EncodersConfig, RigConfig, SimulationConfig, defaults, section_of
from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.rig import POPULATIONS, EncoderVariation, RigParameters, RigVariation, draw, on_road

_MOST_DIGITS: Final = 20
"""Digits of a seed below 2^64; rejects absurdly long numbers before they are converted."""
_OWN: Final = ("parameters", "brake_rate_per_s")
"""Keys of [simulation] that describe the published rig."""


def simulated_rig(config: RigConfig, wheel_edge: float = 0.0, road_edge: float = 0.0) -> RigVariation:
    """Return the rig of [simulation] on its own road; raises ConfigError for an invalid drawn one.

    `wheel_edge` and `road_edge`, in counts 0..1, are the positions of the published rig's ideal encoders between two
    lines at power-up. A drawn rig has its own.
    """
    simulation = config.simulation
    if simulation.rig:
        mistakes = list(rig_check(config.as_table()))
        if mistakes:
            raise ConfigError(mistakes)
        population, _, seed = simulation.rig.partition(":")
        return draw(simulation.population or population, int(seed))
    counts = simulation.counts_per_turn or config.encoders.counts_per_turn
    return RigVariation(
        replace(RigParameters.named(simulation.parameters), c31=simulation.brake_rate_per_s),
        wheel_encoder=EncoderVariation(counts, wheel_edge),
        road_encoder=EncoderVariation(counts, road_edge),
    )


def roads_of_stops(config: RigConfig, rig: RigVariation) -> tuple[RigVariation, ...]:
    """Return the simulated rig on the road of each stop in turn; raises ConfigError for one that is not possible."""
    try:
        return tuple(on_road(rig, text) for text in config.simulation.roads or ())
    except ValueError as error:
        raise ConfigError.of("simulation.roads", str(error)) from error


def drawn_facts(config: RigConfig) -> dict[str, str]:
    """Return the drawn rig's differences from the published one, as text; raises ConfigError as `simulated_rig`."""
    if not config.simulation.rig:
        return {}
    rig, published = _flat(simulated_rig(config)), _flat(RigVariation())
    own = {name: value for name, value in rig.items() if value != published[name]}
    return {name: value if isinstance(value, str) else repr(value) for name, value in own.items()}


def rig_check(table: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    """Check for `load_config`: a drawn rig must exist, the rest must match it, and roads must be possible."""
    yield from _drawn_check(table)
    roads, published = section_of(table, "simulation").get("roads"), RigVariation()
    for text in roads if isinstance(roads, list) else ():
        try:
            on_road(published, str(text))
        except ValueError as error:
            yield ConfigIssue("simulation.roads", str(error))


def _drawn_check(table: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    simulation = section_of(table, "simulation")
    name = simulation.get("rig", "")
    if not isinstance(name, str) or not name:
        return
    shown = reprlib.repr(name)  # however long it is
    population, _, seed = name.partition(":")
    text = simulation.get("population", "")
    if isinstance(text, str) and text:
        try:
            draw(text, 0)
        except ValueError as error:
            yield ConfigIssue("simulation.population", str(error))
            return
    elif population not in POPULATIONS:
        known = f"no population {reprlib.repr(population)}{near_match(population, POPULATIONS)}"
        yield ConfigIssue("simulation.rig", f"{shown}: must be population and seed, as in hard:17; {known}")
        return
    if not _is_seed(seed):
        problem = f"{shown}: the seed must be a whole number in 0..2^64-1, as in {population}:17"
        yield ConfigIssue("simulation.rig", problem)
        return
    for key in _OWN:
        default = defaults(SimulationConfig)[key]
        if simulation.get(key, default) != default:
            yield ConfigIssue(f"simulation.{key}", f"{simulation[key]!r}: {name} has its own; leave one of them out")
    try:
        rig = draw(text or population, int(seed))
    except ValueError as error:  # a factor may leave the range for some of the seeds
        yield ConfigIssue("simulation.rig", f"{shown}: this draw is impossible: {error}; narrow its factor")
        return
    yield from _counts_mistakes(table, name, rig.road_encoder.counts_per_turn)


def _counts_mistakes(table: Mapping[str, Any], name: str, counts: int) -> Iterator[ConfigIssue]:
    """Yield a mismatch between the drawn encoders and the configured ones."""
    stated = section_of(table, "simulation").get("counts_per_turn")
    configured = section_of(table, "encoders").get("counts_per_turn", EncodersConfig().counts_per_turn)
    if stated is not None and stated != counts:
        yield ConfigIssue("simulation.counts_per_turn", f"{stated!r}: {name} has {counts}; leave the key out")
    elif stated is None and configured != counts:
        problem = f"{configured!r}: {name} has {counts} counts per turn; set this to {counts} too"
        yield ConfigIssue(
            "encoders.counts_per_turn", f"{problem}, or simulation.counts_per_turn if the mismatch is intended"
        )


def _is_seed(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS and int(text) < 1 << 64


def _flat(rig: RigVariation) -> dict[str, object]:
    """Return every number of a rig by its dotted name, except the loop's delay and the seed of the noise."""
    flat: dict[str, object] = {}
    for name, value in asdict(rig).items():
        if isinstance(value, dict):
            flat.update({f"{name}.{key}": each for key, each in value.items()})
        elif name not in {"command_delay_ticks", "seed"}:
            flat[name] = value
    return flat
