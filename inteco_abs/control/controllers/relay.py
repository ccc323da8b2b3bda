"""Relays on the slip, as in the two demonstrations of the vendor's toolbox."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

from inteco_abs.control.controllers.base import Gain, Setup
from inteco_abs.control.functions import Function
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate

_MOST_RATE_HZ: Final = 10_000.0
"""Highest `loop.rate_hz`."""
_ROOM: Final = 8
"""Commands for which there is room beyond those of the dead time, for ticks that come early."""
_LEVELS = (
    Gain("on_duty", 1.0, 0.0, 1.0, "1", "duty while the slip is below the reference"),
    Gain("off_duty", 0.0, 0.0, 1.0, "1", "duty while it is not"),
)


@dataclass(frozen=True, slots=True)
class RelayConstants:
    """Duties."""

    on_duty: float
    off_duty: float


@dataclass(slots=True)
class RelayState:
    """Whether the brake is on."""

    reference: float = 0.0
    """Slip to hold now."""
    on: bool = False


def relay(k: RelayConstants, s: RelayState, estimate: Estimate, dt_s: float) -> BrakeDemand:  # noqa: ARG001  a static law
    """Full or no brake by the slip error."""
    switching = estimate.slip - s.reference
    s.on = switching < 0.0
    return BrakeDemand(k.on_duty if s.on else k.off_duty, 0.0, switching, (0.0, 0.0, 0.0, 0.0))


class Relay(RelayState):
    """Brake on while the slip is below the reference, off above."""

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(relay)
    gains: ClassVar[tuple[Gain, ...]] = _LEVELS
    internals: ClassVar[tuple[Quantity, ...]] = ()

    def __init__(self, setup: Setup, on_duty: float, off_duty: float) -> None:
        super().__init__(reference=setup.reference_slip)
        self.k = RelayConstants(on_duty, off_duty)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Full or no brake by the slip error."""
        return relay(self.k, self, estimate, dt_s)


@dataclass(frozen=True, slots=True)
class SmithConstants(RelayConstants):
    """Constants of the relay, of the brake and of the slip that it makes."""

    dead_time_s: float
    rise_per_s: float
    fall_per_s: float
    length: int
    """Commands that the rings hold."""


@dataclass(slots=True)
class SmithState:
    """The commands that have not acted: rings of their durations in s, and of what each adds to the slip."""

    durations_s: list[float]
    rises: list[float]
    reference: float = 0.0
    """Slip to hold now."""
    first: int = 0
    """Place of the oldest one."""
    under_way: int = 0
    waiting_s: float = 0.0
    """Sum of their durations."""
    rise: float = 0.0
    """Sum of what they add."""
    on: bool = False


def smith_relay(k: SmithConstants, s: SmithState, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Full or no brake by the error of the expected slip."""
    _count(k, s, dt_s)
    expected = estimate.slip + s.rise
    switching = expected - s.reference
    s.on = switching < 0.0
    return BrakeDemand(k.on_duty if s.on else k.off_duty, 0.0, switching, (expected, 0.0, 0.0, 0.0))


def _count(k: SmithConstants, s: SmithState, dt_s: float) -> None:
    """Add the effect of the last period's command, and drop what has acted by now."""
    if s.under_way == k.length:
        _drop(k, s)
    place, rise = (s.first + s.under_way) % k.length, (k.rise_per_s if s.on else -k.fall_per_s) * dt_s
    s.durations_s[place], s.rises[place] = dt_s, rise
    s.under_way += 1
    s.waiting_s += dt_s
    s.rise += rise
    while s.under_way > 0 and s.waiting_s - s.durations_s[s.first] >= k.dead_time_s:
        _drop(k, s)
    if s.under_way == 0:
        s.waiting_s = s.rise = 0.0  # rounding errors must not accumulate


def _drop(k: SmithConstants, s: SmithState) -> None:
    s.waiting_s -= s.durations_s[s.first]
    s.rise -= s.rises[s.first]
    s.first = (s.first + 1) % k.length
    s.under_way -= 1


class SmithRelay(SmithState):
    """Relay on the slip predicted for the end of the brake's dead time: a Smith predictor with an integrator as model.

    Each command that has not acted yet adds a ramp to the slip, up for brake on and down for brake off. Dead time and
    slopes are those of the vendor's demonstration (27 ms, +11 and -1.74 1/s).
    """

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(smith_relay)
    gains: ClassVar[tuple[Gain, ...]] = (
        *_LEVELS,
        Gain("dead_time_s", 0.027, 0.0, 0.2, "s", "time until a command acts", fixed=True),
        Gain("rise_per_s", 11.0, 0.0, 100.0, "1/s", "slip rate with the brake on"),
        Gain("fall_per_s", 1.74, 0.0, 100.0, "1/s", "slip rate with the brake off, downwards"),
    )
    internals: ClassVar[tuple[Quantity, ...]] = (Quantity("slip_expected", "1", "slip at the end of the dead time"),)

    def __init__(
        self,
        setup: Setup,
        on_duty: float,
        off_duty: float,
        dead_time_s: float,
        rise_per_s: float,
        fall_per_s: float,
    ) -> None:
        length = int(dead_time_s * _MOST_RATE_HZ) + _ROOM
        super().__init__([0.0] * length, [0.0] * length, reference=setup.reference_slip)
        self.k = SmithConstants(on_duty, off_duty, dead_time_s, rise_per_s, fall_per_s, length)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Full or no brake by the error of the expected slip."""
        return smith_relay(self.k, self, estimate, dt_s)
