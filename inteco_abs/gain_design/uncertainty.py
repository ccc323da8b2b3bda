"""Uncertainty of a rig: ranges of single parameters, and the box of rigs that they span."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any, Final, NamedTuple

from inteco_abs.config import RigConfig
from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.rig import RigParameters, RigVariation, nominal_parameters

HARD: Final = (
    "J1=5%",
    "J2=5%",
    "Mg=5%",
    "d1=20%",
    "d2=20%",
    "mu=15%",
    "adhesion_blend=1",
    "brake_gain=5%",
    "brake_duty_offset=0.02",
)
"""The population `hard`, except for the shape of its measured brake map, which is up to 1.2 N m off the straight line;
`b2=1.2` covers it. Lag, dead time and encoders are not in the conditions of sliding."""
_OF_THE_RIG: Final = {
    "mu": "adhesion_scale",
    "adhesion_blend": "adhesion_blend",
    "brake_gain": "brake_gain",
    "brake_duty_offset": "brake_duty_offset",
}
_FROM_ZERO: Final = {"adhesion_blend": 1.0, "brake_duty_offset": 0.2}
"""Largest value of parameters that are 0 on the published rig; given as a number, as 0 has no percentage."""
_TERMS: Final = ("f", "g")
_WITHOUT_EFFECT: Final = {
    "c31": "the brake's lag is not in the law, and (25) and (26) do not see it",
    "u0": "the end of the dead zone does not matter where the brake holds a slip; use b2 for an offset of the torque",
}
_MOST_PERCENT: Final = 90.0
_MOST_NAMES: Final = 12  # 4096 corners
KNOWN: Final = (
    *(field.name for field in fields(RigParameters) if field.name not in _WITHOUT_EFFECT),
    *_OF_THE_RIG,
    *_TERMS,
)
"""Parameters that can be uncertain: constants of model and brake line, factors on adhesion and brake, f and g."""


class ParameterRange(NamedTuple):
    """Range of one parameter, in its unit."""

    name: str
    low: float
    high: float


class SampledRig(NamedTuple):
    """One rig of the box."""

    rig: RigVariation
    f_factor: float
    """Factor on f, besides the effect of the rig's parameters."""
    g_factor: float


@dataclass(frozen=True, slots=True)
class Box:
    """All rigs within the ranges around the controller's nominal parameters."""

    nominal: RigParameters
    spreads: tuple[ParameterRange, ...]

    def draw(self, values: Mapping[str, float]) -> SampledRig:
        """The rig with these values; all others are nominal."""
        own: dict[str, Any] = {_OF_THE_RIG[name]: value for name, value in values.items() if name in _OF_THE_RIG}
        constants = {name: value for name, value in values.items() if name not in {*_OF_THE_RIG, *_TERMS}}
        rig = replace(RigVariation(replace(self.nominal, **constants)), **own)
        return SampledRig(rig, values.get("f", 1.0), values.get("g", 1.0))

    def faded(self, share: float) -> Box:
        """The box with brakes that may have lost up to this share of their torque, 0..1."""
        gain = next((one for one in self.spreads if one.name == "brake_gain"), ParameterRange("brake_gain", 1.0, 1.0))
        others = tuple(one for one in self.spreads if one != gain)
        return Box(self.nominal, (*others, gain._replace(low=gain.low * (1.0 - share))))

    def corners(self) -> Iterator[SampledRig]:
        """The rigs with each parameter at one end of its range."""
        names = [spread.name for spread in self.spreads]
        for ends in product(*((spread.low, spread.high) for spread in self.spreads)):
            yield self.draw(dict(zip(names, ends, strict=True)))


def faded_share(config: RigConfig) -> float:
    """Share of the brake's torque that an identified fade may cost in a stop from the start speed, 0..1.

    The brake can take no more than the energy of both wheels as they roll.
    """
    k, speed = nominal_parameters(config.model), config.experiment.start_speed_rad_s
    energy_kj = 0.5e-3 * (k.J2 + (k.r2 / k.r1) ** 2 * k.J1) * speed * speed
    return 1.0 - 1.0 / (1.0 + (config.model.identified.brake_fade_per_kj or 0.0) * energy_kj)


def stated_box(statements: Sequence[str], nominal: RigParameters) -> Box:
    """Box of statements such as `J1=5%` (of the nominal value) or `M10=0.002` (in its unit), in both directions.

    Raises ConfigError with all mistakes.
    """
    spreads: dict[str, ParameterRange] = {}
    mistakes = []
    for statement in statements:
        try:
            spread = _spread(statement, nominal)
        except ValueError as error:
            mistakes.append(ConfigIssue("--uncertain", f"{statement}: {error}"))
            continue
        if spread.name in spreads:
            mistakes.append(ConfigIssue("--uncertain", f"{statement}: {spread.name} is stated twice; once is enough"))
        spreads[spread.name] = spread
    if len(spreads) > _MOST_NAMES:
        mistakes.append(
            ConfigIssue(
                "--uncertain", f"{len(spreads)} names: must be at most {_MOST_NAMES}; leave out what matters least"
            )
        )
    if mistakes:
        raise ConfigError(mistakes)
    return Box(nominal, tuple(spreads.values()))


def _spread(statement: str, nominal: RigParameters) -> ParameterRange:
    """Parse one statement. Raises ValueError."""
    name, equals, text = (part.strip() for part in statement.partition("="))
    if not equals or not name:
        raise ValueError("must look like J1=5% or M10=0.002")
    if name in _WITHOUT_EFFECT:
        raise ValueError(f"does not count here: {_WITHOUT_EFFECT[name]}")
    if name not in KNOWN:
        raise ValueError(f"unknown parameter {name!r}{near_match(name, KNOWN)}")
    try:
        number = float(text.removesuffix("%"))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{text!r} must be a number, in percent of {name} or in its unit")
    if number < 0.0:
        raise ValueError("must not be negative: a parameter may be off by so much both ways")
    return _from_zero(name, number, text) if name in _FROM_ZERO else _around(name, number, text, nominal)


def _from_zero(name: str, number: float, text: str) -> ParameterRange:
    most = _FROM_ZERO[name]
    if text.endswith("%"):
        raise ValueError(f"percent of nothing: {name} is nominally 0, state it as a number up to {most:g}")
    if number > most:
        raise ValueError(f"must be at most {most:g}")
    return ParameterRange(name, 0.0 if name == "adhesion_blend" else -number, number)


def _around(name: str, number: float, text: str, nominal: RigParameters) -> ParameterRange:
    center: float = getattr(nominal, name, 1.0)
    off = abs(center) * number / 100.0 if text.endswith("%") else number
    most = abs(center) * _MOST_PERCENT / 100.0
    if off > most:
        raise ValueError(f"must be at most {_MOST_PERCENT:g} % of {name} = {center:g}, which is {most:g}")
    return ParameterRange(name, center - off, center + off)
