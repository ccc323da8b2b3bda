"""What the published laws share: a controller made of one function, its gains, and the nominal rig."""

from __future__ import annotations

from dataclasses import dataclass, make_dataclass
from typing import Any, ClassVar

from inteco_abs.control import BrakingModel, Function, Gain, Setup, SlipConstants, slip_terms
from inteco_abs.quantities import Quantity
from inteco_abs.rig import brake_duty
from inteco_abs.signals import BrakeDemand, Estimate

_LEAST_SPEED_RAD_S = 1.0
"""For the model, whose f and g grow without limit as the road stops."""


@dataclass(frozen=True, slots=True)
class LawConstants:
    """Constants of every published law; each adds its gains by their names."""

    hold_below: float
    """Road speed below which a law with a model holds its last demand, rad/s."""
    model: SlipConstants


@dataclass(slots=True)
class PublishedState:
    """State of every published law; each adds its own, all of it with defaults."""

    reference: float = 0.0
    """Slip to hold now."""


class PublishedLaw(PublishedState):
    """A law as `function` of constants, state, estimate and time; it also derives from its state, a dataclass."""

    gains: ClassVar[tuple[Gain, ...]]
    internals: ClassVar[tuple[Quantity, ...]] = ()
    function: ClassVar[Function]
    constants: ClassVar[type[LawConstants]] = LawConstants
    """Its constants but for the gains."""
    _constants: ClassVar[type]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        own = [(gain.name, float) for gain in cls.gains]
        cls._constants = make_dataclass(cls.__name__, own, bases=(cls.constants,), frozen=True, slots=True)

    def __init__(self, setup: Setup, **gains: float) -> None:
        super().__init__(reference=setup.reference_slip)
        model = BrakingModel(setup.parameters)
        self.k = self._constants(setup.hold_below_rad_s, model, **gains)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand of the law."""
        demand: BrakeDemand = type(self).function(self.k, self, estimate, dt_s)
        return demand


def terms(k: Any, slip: float, road_speed: float) -> tuple[float, float]:
    """The slip's rate without torque in 1/s, and per N m: f and g of the nominal rig, equations (16) and (17)."""
    f, g = slip_terms(k.model, min(max(slip, 0.0), 1.0), max(road_speed, _LEAST_SPEED_RAD_S))
    return f, g


def duty_of(k: Any, torque: float) -> float:
    """Duty for a torque in N m by the brake's straight line, as the manual and the papers on this rig have it."""
    duty: float = min(1.0, brake_duty(torque, k.model.parameters))
    return duty


def demand(duty: float, torque: float, error: float, first: float = 0.0) -> BrakeDemand:
    """A demand of a duty within 0..1."""
    return BrakeDemand(min(max(duty, 0.0), 1.0), torque, error, (first, 0.0, 0.0, 0.0))


def limited(value: float, most: float) -> float:
    """Within -most..most."""
    return min(max(value, -most), most)
