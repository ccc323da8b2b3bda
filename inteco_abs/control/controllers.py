"""Slip controllers: from an estimate to a brake demand. Pure, scalar, one class each.

A controller of your own is a class with the same three parts: `gains`, `internals` and `update`.
"""

from __future__ import annotations

from typing import ClassVar, Final, NamedTuple, Protocol

from inteco_abs.control.model import BrakingModel, reaching_torque
from inteco_abs.rig import RigParameters, brake_duty
from inteco_abs.signals import BrakeDemand, Estimate


class Gain(NamedTuple):
    """One adjustable number of a controller, with its range and unit."""

    name: str
    default: float
    low: float
    high: float
    unit: str
    meaning: str


class Setup(NamedTuple):
    """What every controller is told besides its own gains."""

    reference_slip: float
    """In 0..1."""
    parameters: RigParameters
    """What the controller may believe about the rig."""
    hold_below_rad_s: float
    """Estimated road speed below which a model-based law holds its last demand."""


class Controller(Protocol):
    """Asks for brake while the experiment is braking; no clock, no I/O, no randomness."""

    gains: ClassVar[tuple[Gain, ...]]
    internals: ClassVar[tuple[str, ...]]
    """Names of up to four values that `BrakeDemand.internals` carries into the log, with units."""

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand for the next period; `dt_s` is the time since the previous sample."""
        ...


class ReachingLaw:
    """Sliding mode control with the constant plus proportional reaching law, equations (18) to (22).

    The torque becomes a duty through the brake's static map; the brake's lag is not in the law, as in the paper.
    Below `hold_below_rad_s` the last demand is held, because f and g grow without limit as the road stops.
    """

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("Mk", 2.0, 0.0, 1000.0, "1/s", "proportional rate: shortens the reaching phase"),
        Gain("Mq", 1.0, 0.0, 1000.0, "1/s", "constant rate: rejects model error, as small as possible"),
    )
    internals: ClassVar[tuple[str, ...]] = ("f_per_s", "g_per_s_nm", "torque_eq_nm", "")

    def __init__(self, setup: Setup, Mk: float, Mq: float) -> None:
        self._reference = setup.reference_slip
        self._hold_below = setup.hold_below_rad_s
        self._model = BrakingModel(setup.parameters)
        self._Mk = Mk
        self._Mq = Mq
        self._last = BrakeDemand(0.0)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:  # noqa: ARG002  a static law
        """Demand by equation (22), limited to what the brake can do."""
        slip, speed = estimate.slip, estimate.road_speed_rad_s
        if not estimate.valid or speed <= self._hold_below:
            return self._last
        f, g = self._model.terms(slip, speed)
        switching = slip - self._reference
        torque = reaching_torque(f, g, switching, self._Mk, self._Mq)
        duty = min(1.0, brake_duty(torque, self._model.parameters))
        self._last = BrakeDemand(duty, torque, switching, (f, g, -f / g, 0.0))
        return self._last


class Relay:
    """Brake on while the slip is below the reference, off above: the vendor's demonstration."""

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("on_duty", 1.0, 0.0, 1.0, "1", "duty while the slip is below the reference"),
        Gain("off_duty", 0.0, 0.0, 1.0, "1", "duty while it is not"),
    )
    internals: ClassVar[tuple[str, ...]] = ()

    def __init__(self, setup: Setup, on_duty: float, off_duty: float) -> None:
        self._reference = setup.reference_slip
        self._on = on_duty
        self._off = off_duty

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:  # noqa: ARG002  a static law
        """On or off by the sign of the slip error."""
        switching = estimate.slip - self._reference
        return BrakeDemand(self._on if switching < 0.0 else self._off, 0.0, switching)


CONTROLLERS: Final[dict[str, type[Controller]]] = {
    "reaching-law": ReachingLaw,
    "relay": Relay,
}
"""Controllers that ship, by the name on the command line."""
