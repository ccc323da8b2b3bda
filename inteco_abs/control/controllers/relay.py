"""Relays on the slip, as in the two demonstrations of the vendor's toolbox."""

from __future__ import annotations

from collections import deque
from typing import ClassVar

from inteco_abs.control.controllers.base import Gain, Setup
from inteco_abs.signals import BrakeDemand, Estimate

_LEVELS = (
    Gain("on_duty", 1.0, 0.0, 1.0, "1", "duty while the slip is below the reference"),
    Gain("off_duty", 0.0, 0.0, 1.0, "1", "duty while it is not"),
)


class Relay:
    """Brake on while the slip is below the reference, off above."""

    gains: ClassVar[tuple[Gain, ...]] = _LEVELS
    internals: ClassVar[tuple[str, ...]] = ()

    def __init__(self, setup: Setup, on_duty: float, off_duty: float) -> None:
        self._reference = setup.reference_slip
        self._on = on_duty
        self._off = off_duty

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:  # noqa: ARG002  a static law
        switching = estimate.slip - self._reference
        return BrakeDemand(self._on if switching < 0.0 else self._off, 0.0, switching)


class SmithRelay:
    """Relay on the slip predicted for the end of the brake's dead time: a Smith predictor with an integrator as model.

    Each command that has not acted yet adds a ramp to the slip, up for brake on and down for brake off. Dead time and
    slopes are those of the vendor's demonstration (27 ms, +11 and -1.74 1/s).
    """

    gains: ClassVar[tuple[Gain, ...]] = (
        *_LEVELS,
        Gain("dead_time_s", 0.027, 0.0, 0.2, "s", "time until a command acts"),
        Gain("rise_per_s", 11.0, 0.0, 100.0, "1/s", "slip rate with the brake on"),
        Gain("fall_per_s", 1.74, 0.0, 100.0, "1/s", "slip rate with the brake off, downwards"),
    )
    internals: ClassVar[tuple[str, ...]] = ("slip_expected",)

    def __init__(
        self,
        setup: Setup,
        on_duty: float,
        off_duty: float,
        dead_time_s: float,
        rise_per_s: float,
        fall_per_s: float,
    ) -> None:
        self._reference = setup.reference_slip
        self._duties = off_duty, on_duty
        self._rates = -fall_per_s, rise_per_s
        self._dead_time_s = dead_time_s
        self._under_way: deque[tuple[float, float]] = deque()  # duration of each command that has not acted, its rise
        self._waiting_s = 0.0
        self._rise = 0.0
        self._on = False

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        self._count(dt_s)
        expected = estimate.slip + self._rise
        switching = expected - self._reference
        self._on = switching < 0.0
        return BrakeDemand(self._duties[self._on], 0.0, switching, (expected, 0.0, 0.0, 0.0))

    def _count(self, dt_s: float) -> None:
        """Add the effect of the last period's command, and drop what has acted by now."""
        self._under_way.append((dt_s, self._rates[self._on] * dt_s))
        self._waiting_s += dt_s
        self._rise += self._rates[self._on] * dt_s
        while self._under_way and self._waiting_s - self._under_way[0][0] >= self._dead_time_s:
            duration_s, rise = self._under_way.popleft()
            self._waiting_s -= duration_s
            self._rise -= rise
        if not self._under_way:
            self._waiting_s = self._rise = 0.0  # rounding errors must not accumulate
