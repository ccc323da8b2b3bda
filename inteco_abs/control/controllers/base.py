"""The interface of slip controllers, and the base class of those that invert the slip model.

A controller is a class with `gains`, `internals` and `update`. One that needs a certain estimator names it as
`estimator`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Final, NamedTuple, Protocol

from inteco_abs.control.slip_dynamics import BrakingModel
from inteco_abs.rig import MEASURED_MAP, BrakeMap, RigParameters, brake_duty, brake_torque
from inteco_abs.signals import BrakeDemand, Estimate


class Gain(NamedTuple):
    """One adjustable number of a controller, with its range and unit."""

    name: str
    """Argument of the class, and key in `controller.gains`."""
    default: float
    low: float
    """Smallest value that a configuration may have."""
    high: float
    """Largest value."""
    unit: str
    """Such as `1/s`; `1` for a number without a unit."""
    meaning: str


LAG: Final = Gain("lag_s", 0.0, 0.0, 0.2, "s", "lag of the brake to be inverted; 0: no lag")
"""A gain of every `ModelLaw`."""


class Setup(NamedTuple):
    """What every controller gets besides its own gains."""

    reference_slip: float
    """In 0..1."""
    parameters: RigParameters
    """Nominal parameters of the rig."""
    hold_below_rad_s: float
    """Estimated road speed below which a model-based law holds its last demand."""
    brake_map: BrakeMap = MEASURED_MAP
    """Nominal static map of the brake, where the straight line of `parameters` is not enough."""


class Controller(Protocol):
    """Demands a brake duty while the experiment is braking; no clock, no I/O, no randomness."""

    gains: ClassVar[tuple[Gain, ...]]
    internals: ClassVar[tuple[str, ...]]
    """Names of up to four values that `BrakeDemand.internals` carries into the log, with units."""

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand for the next period; `dt_s` is the time since the previous sample."""
        ...


class ModelLaw(ABC):
    """A law for the decay of the slip error, which inverts the slip model for the torque, equation (21).

    The brake's static map turns the torque into a duty. As in the paper, the brake is taken to be without lag, unless
    `lag_s` is given: then the duty is the one that reaches the torque within a period, as far as the brake can. Below
    `hold_below_rad_s` the last demand is held, because f and g grow without limit as the road stops.
    """

    internals: ClassVar[tuple[str, ...]] = ("f_per_s", "g_per_s_nm", "torque_eq_nm", "")

    def __init__(self, setup: Setup, lag_s: float = 0.0) -> None:
        self._lag_s = lag_s
        self._lagged_nm = 0.0
        self._settled_nm = 0.0
        self._reference = setup.reference_slip
        self._hold_below = setup.hold_below_rad_s
        self._model = BrakingModel(setup.parameters)
        self._full_nm = brake_torque(1.0, setup.parameters)
        self._last = BrakeDemand(0.0)

    @abstractmethod
    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:
        """Rate at which the slip error `switching` shall decay, 1/s: minus its wanted derivative."""

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand for that decay, limited to what the brake can do."""
        slip, speed = estimate.slip, estimate.road_speed_rad_s
        if not estimate.valid or speed <= self._hold_below:
            return self._last
        f, g = self._model.terms(slip, speed)
        switching = slip - self._reference
        torque = -(f + self.approach(switching, speed, dt_s)) / g
        settled = torque if self._lag_s == 0.0 else self._ahead_of_lag(torque, dt_s)
        duty = min(1.0, brake_duty(settled, self._model.parameters))
        self._last = BrakeDemand(duty, torque, switching, (f, g, -f / g, 0.0))
        return self._last

    def _ahead_of_lag(self, torque: float, dt_s: float) -> float:
        """Settled torque in N m that brings a brake with the lag `lag_s` to `torque` within a period."""
        share = 1.0 - math.exp(-dt_s / self._lag_s)
        self._lagged_nm += (self._settled_nm - self._lagged_nm) * share
        self._settled_nm = min(max(self._lagged_nm + (torque - self._lagged_nm) / share, 0.0), self._full_nm)
        return self._settled_nm

    @property
    def _saturated(self) -> bool:
        """Whether the last torque was outside the brake's range; integrals are held then."""
        return not 0.0 < self._last.torque_nm < self._full_nm


def sign(value: float) -> float:
    """Return -1, 0 or 1; 0 on the switching surface itself."""
    return float((value > 0.0) - (value < 0.0))
