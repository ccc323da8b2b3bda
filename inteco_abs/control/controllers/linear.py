"""Controllers without a model: proportional-integral, and open loop steps for identification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from inteco_abs.control.controllers.base import Gain, Setup
from inteco_abs.control.functions import Function
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate


@dataclass(frozen=True, slots=True)
class LinearConstants:
    """Gains."""

    Kp: float
    Ki: float
    bias: float


@dataclass(slots=True)
class LinearState:
    """The integral, as a duty."""

    reference: float = 0.0
    """Slip to hold now."""
    integral: float = 0.0


def proportional_integral(k: LinearConstants, s: LinearState, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Limited duty; anti-windup by conditional integration."""
    error = s.reference - estimate.slip
    step = k.Ki * error * dt_s
    duty = k.bias + k.Kp * error + s.integral + step
    if 0.0 <= duty <= 1.0 or (duty > 1.0) != (step > 0.0):
        s.integral += step
    duty = max(0.0, min(1.0, k.bias + k.Kp * error + s.integral))
    return BrakeDemand(duty, 0.0, -error, (s.integral, 0.0, 0.0, 0.0))


class ProportionalIntegral(LinearState):
    """Duty = bias + Kp*e + Ki*integral(e), e = reference - slip; the integral is held where it would wind up."""

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(proportional_integral)
    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("Kp", 1.0, 0.0, 100.0, "1", "proportional"),
        Gain("Ki", 5.0, 0.0, 1000.0, "1/s", "integral"),
        Gain("bias", 0.6, 0.0, 1.0, "1", "duty at no error, near what holds the slip"),
    )
    internals: ClassVar[tuple[Quantity, ...]] = (Quantity("integral_duty", "1", "integral of the slip error, a duty"),)

    def __init__(self, setup: Setup, Kp: float, Ki: float, bias: float) -> None:
        super().__init__(reference=setup.reference_slip)
        self.k = LinearConstants(Kp, Ki, bias)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Return the limited duty."""
        return proportional_integral(self.k, self, estimate, dt_s)


@dataclass(frozen=True, slots=True)
class StepsConstants:
    """Gains."""

    first: float
    rise: float
    length_s: float


@dataclass(slots=True)
class StepsState:
    """Time since the first demand."""

    reference: float = 0.0
    """Slip to hold now."""
    elapsed_s: float = 0.0


def staircase(k: StepsConstants, s: StepsState, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Duty of the current step; the first begins with the first demand."""
    step = int(s.elapsed_s / k.length_s)
    s.elapsed_s += dt_s
    duty = max(0.0, min(1.0, k.first + k.rise * step))
    return BrakeDemand(duty, 0.0, estimate.slip - s.reference, (0.0, 0.0, 0.0, 0.0))


class Steps(StepsState):
    """A staircase of duties, independent of the slip: the brake steps of an identification."""

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(staircase)
    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("first", 0.65, 0.0, 1.0, "1", "duty of the first step"),
        Gain("rise", 0.0, -1.0, 1.0, "1", "added from step to step"),
        Gain("length_s", 1.0, 0.001, 60.0, "s", "of each step"),
    )
    internals: ClassVar[tuple[Quantity, ...]] = ()

    def __init__(self, setup: Setup, first: float, rise: float, length_s: float) -> None:
        super().__init__(reference=setup.reference_slip)
        self.k = StepsConstants(first, rise, length_s)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Duty of the current step; the first begins with the first demand."""
        return staircase(self.k, self, estimate, dt_s)
