"""Controllers without a model: proportional-integral, and open loop steps for identification."""

from __future__ import annotations

from typing import ClassVar

from inteco_abs.control.controllers.base import Gain, Setup
from inteco_abs.signals import BrakeDemand, Estimate


class ProportionalIntegral:
    """Duty = bias + Kp*e + Ki*integral(e), e = reference - slip; the integral is held where it would wind up."""

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("Kp", 1.0, 0.0, 100.0, "1", "proportional"),
        Gain("Ki", 5.0, 0.0, 1000.0, "1/s", "integral"),
        Gain("bias", 0.6, 0.0, 1.0, "1", "duty at no error, near what holds the slip"),
    )
    internals: ClassVar[tuple[str, ...]] = ("integral_duty",)

    def __init__(self, setup: Setup, Kp: float, Ki: float, bias: float) -> None:
        self._reference = setup.reference_slip
        self._Kp = Kp
        self._Ki = Ki
        self._bias = bias
        self._integral = 0.0

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Limited duty; anti-windup by conditional integration."""
        error = self._reference - estimate.slip
        step = self._Ki * error * dt_s
        duty = self._bias + self._Kp * error + self._integral + step
        if 0.0 <= duty <= 1.0 or (duty > 1.0) != (step > 0.0):
            self._integral += step
        duty = max(0.0, min(1.0, self._bias + self._Kp * error + self._integral))
        return BrakeDemand(duty, 0.0, -error, (self._integral, 0.0, 0.0, 0.0))


class Steps:
    """A staircase of duties, independent of the slip: the brake steps of an identification."""

    gains: ClassVar[tuple[Gain, ...]] = (
        Gain("first", 0.65, 0.0, 1.0, "1", "duty of the first step"),
        Gain("rise", 0.0, -1.0, 1.0, "1", "added from step to step"),
        Gain("length_s", 1.0, 0.001, 60.0, "s", "of each step"),
    )
    internals: ClassVar[tuple[str, ...]] = ()

    def __init__(self, setup: Setup, first: float, rise: float, length_s: float) -> None:
        self._reference = setup.reference_slip
        self._first = first
        self._rise = rise
        self._length_s = length_s
        self._elapsed_s = 0.0

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Duty of the current step; the first begins with the first demand."""
        step = int(self._elapsed_s / self._length_s)
        self._elapsed_s += dt_s
        duty = max(0.0, min(1.0, self._first + self._rise * step))
        return BrakeDemand(duty, 0.0, estimate.slip - self._reference)
