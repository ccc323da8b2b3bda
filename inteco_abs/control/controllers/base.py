"""The interface of slip controllers, and the base class of those that invert the slip model.

A controller is a class with `gains`, `internals` and `update`. One that needs a certain estimator names it as
`estimator`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, make_dataclass
from functools import partial
from typing import Any, ClassVar, Final, NamedTuple, Protocol

from inteco_abs import elementary
from inteco_abs.control.functions import Function
from inteco_abs.control.slip_dynamics import BrakingModel, SlipConstants, slip_terms
from inteco_abs.quantities import Quantity
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
    """As in UCUM, such as `1/s` or `N.m`; `1` for a number without a dimension."""
    meaning: str
    fixed: bool = False
    """Whether it stays while a run lasts, as one that sizes what the controller keeps."""

    @property
    def quantity(self) -> Quantity:
        """Without its values."""
        return Quantity(self.name, self.unit, self.meaning)


LAG: Final = Gain("lag_s", 0.0, 0.0, 0.2, "s", "lag of the brake to be inverted; 0: no lag")
"""A gain of every `ModelLaw`."""


class Setup(NamedTuple):
    """What every controller gets besides its own gains."""

    reference_slip: float
    """Slip to hold, 0..1."""
    parameters: RigParameters
    """Nominal parameters of the rig."""
    hold_below_rad_s: float
    """Estimated road speed below which a model-based law holds its last demand."""
    brake_map: BrakeMap = MEASURED_MAP
    """Nominal static map of the brake, where the straight line of `parameters` is not enough."""


class Controller(Protocol):
    """Demands a brake duty while the experiment is braking; no clock, no I/O, no randomness."""

    gains: ClassVar[tuple[Gain, ...]]
    internals: ClassVar[tuple[Any, ...]]
    """Up to four values that `BrakeDemand.internals` carries into the log: each a `Quantity`, or its name."""

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand for the next period; `dt_s` is the time since the previous sample."""
        ...


@dataclass(frozen=True, slots=True)
class LawConstants:
    """Constants of every `ModelLaw`; a subclass of it adds its gains by their names."""

    hold_below: float
    """Road speed below which the last demand is held, rad/s."""
    model: SlipConstants
    full_nm: float
    """Torque at full duty."""
    lag_s: float


@dataclass(slots=True)
class LawState:
    """The last demand, the brake's lag, and the law's integral."""

    reference: float = 0.0
    """Slip to hold now."""
    brake: float = 0.0
    torque_nm: float = 0.0
    switching: float = 0.0
    f_per_s: float = 0.0
    g_per_s_nm: float = 0.0
    torque_eq_nm: float = 0.0
    lagged_nm: float = 0.0
    settled_nm: float = 0.0
    integral: float = 0.0


def model_law(k: LawConstants, s: LawState, estimate: Estimate, dt_s: float, rate: Function) -> BrakeDemand:
    """Demand for a slip error that decays at `rate` in 1/s, limited to what the brake can do.

    Raises ValueError for a slip outside of 0..1, and for a speed that is not above 0.
    """
    _, speed, slip, valid, _ = estimate
    if not valid or speed <= k.hold_below:
        internals = s.f_per_s, s.g_per_s_nm, s.torque_eq_nm, 0.0
        return BrakeDemand(s.brake, s.torque_nm, s.switching, internals)
    if not (speed > 0.0 and 0.0 <= slip <= 1.0):
        raise ValueError("the estimate's slip must be in 0..1, and its road speed above 0 rad/s")
    f, g = slip_terms(k.model, slip, speed)
    switching = slip - s.reference
    torque = -(f + rate(k, s, switching, speed, dt_s)) / g
    settled = torque if k.lag_s == 0.0 else _ahead_of_lag(k, s, torque, dt_s)
    brake, equivalent = min(1.0, brake_duty(settled, k.model.parameters)), -f / g
    s.brake, s.torque_nm, s.switching = brake, torque, switching
    s.f_per_s, s.g_per_s_nm, s.torque_eq_nm = f, g, equivalent
    return BrakeDemand(brake, torque, switching, (f, g, equivalent, 0.0))


def _ahead_of_lag(k: LawConstants, s: LawState, torque: float, dt_s: float) -> float:
    """Settled torque in N m that brings a brake with the lag `lag_s` to `torque` within a period."""
    share = 1.0 - elementary.exp(-dt_s / k.lag_s)
    s.lagged_nm += (s.settled_nm - s.lagged_nm) * share
    s.settled_nm = min(max(s.lagged_nm + (torque - s.lagged_nm) / share, 0.0), k.full_nm)
    return s.settled_nm


def saturated(k: LawConstants, s: LawState) -> bool:
    """Whether the last torque was outside the brake's range; integrals are held then."""
    return not 0.0 < s.torque_nm < k.full_nm


def _approach(k: LawConstants, s: Any, switching: float, road_speed: float, dt_s: float) -> float:  # noqa: ARG001  a class's own
    rate: float = s.approach(switching, road_speed, dt_s)
    return rate


class ModelLaw(LawState):
    """A law for the decay of the slip error; it inverts the nominal slip dynamics, equation (22).

    The brake's static map turns the torque into a duty. As in the paper, the brake is taken to be without lag, unless
    `lag_s` is given: then the duty is the one that reaches the torque within a period, as far as the brake can. Below
    `hold_below_rad_s` the last demand is held, because f and g grow without limit as the road stops.

    A law is its `gains` and either a method `approach(switching, road_speed, dt_s)`, the rate in 1/s at which the slip
    error `switching` shall decay (minus its wanted derivative), or, to be compiled for many rigs, a
    `function = law(rate)` with `rate(k, s, switching, road_speed, dt_s)`, which finds the gains in `k`.
    """

    gains: ClassVar[tuple[Gain, ...]] = (LAG,)
    internals: ClassVar[tuple[Quantity, ...]] = (
        Quantity("f_per_s", "1/s", "rate of the slip without brake torque, f in (16)"),
        Quantity("g_per_s_nm", "1/(s.N.m)", "rate of the slip per brake torque, g in (17)"),
        Quantity("torque_eq_nm", "N.m", "torque that would hold the slip, -f/g"),
    )
    _rate: ClassVar[Function] = staticmethod(_approach)
    """Rate in use: that of the function, unless a subclass has its own `approach`."""
    _shipped_rate: ClassVar[Function]
    _constants: ClassVar[type[LawConstants]] = LawConstants

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        function = vars(cls).get("function")
        if function is not None:
            cls._rate = cls._shipped_rate = staticmethod(function.keywords["rate"])
            own = [(gain.name, float) for gain in cls.gains if gain is not LAG]
            cls._constants = make_dataclass(cls.__name__, own, bases=(LawConstants,), frozen=True, slots=True)
        elif "approach" in vars(cls):
            cls._rate = staticmethod(_approach)

    def __init__(self, setup: Setup, *values: float, **gains: float) -> None:
        """Gains by name, or in their order, `lag_s` last and 0 by default.

        Raises TypeError for a gain that is missing, given twice or unknown, ValueError for more values than gains.
        """
        super().__init__(reference=setup.reference_slip)
        full_nm = brake_torque(1.0, setup.parameters)
        model = BrakingModel(setup.parameters)
        names = [*(field.name for field in fields(self._constants)[len(fields(LawConstants)) :]), LAG.name]
        given = dict(zip(names[: len(values)], values, strict=True))
        named = gains if LAG.name in given else {LAG.name: 0.0, **gains}
        self.k = self._constants(setup.hold_below_rad_s, model, full_nm, **given, **named)

    def approach(self, switching: float, road_speed: float, dt_s: float) -> float:
        """Rate in 1/s at which the slip error shall decay."""
        rate: float = self._shipped_rate(self.k, self, switching, road_speed, dt_s)
        return rate

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Demand for that decay, limited to what the brake can do."""
        return model_law(self.k, self, estimate, dt_s, self._rate)


def law(rate: Function) -> Function:
    """The function of a `ModelLaw` with this rate."""
    return partial(model_law, rate=rate)


def sign(value: float) -> float:
    """Return -1, 0 or 1; 0 on the switching surface itself."""
    return float((value > 0.0) - (value < 0.0))
