"""A tracking loop: a model wheel that follows the counted angle through a spring and a damper."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from inteco_abs import elementary
from inteco_abs.config import EstimatorConfig, LoopConfig, RigConfig
from inteco_abs.control.estimators.angles import CountState, rad_per_count, turned
from inteco_abs.control.estimators.registry import EstimatorSpec, on_both_wheels, parameter
from inteco_abs.control.functions import Function
from inteco_abs.errors import ConfigIssue


@dataclass(frozen=True, slots=True)
class TrackingConstants:
    """Constants of the spring and the damper."""

    per_count: float
    """rad"""
    stiffness: float
    """1/s2"""
    damping: float
    """1/s"""


@dataclass(slots=True)
class TrackingState(CountState):
    """State of the model wheel, in rad and rad/s."""

    angle: float = 0.0
    speed: float = 0.0


def tracking(k: TrackingConstants, s: TrackingState, time_ns: int, count: int) -> float:
    """Speed in rad/s."""
    angle, dt_s = turned(k.per_count, s, time_ns, count)
    error = angle - s.angle
    s.speed += k.stiffness * error * dt_s
    s.angle += (s.speed + k.damping * error) * dt_s
    return s.speed


class TrackingLoop(TrackingState):
    """v += wn^2*e*T, th += (v + 2*zeta*wn*e)*T with e = angle - th: lag 2*zeta/wn, noise falling with wn.

    The loop of resolver and encoder converters; `natural_frequency_rad_s` is wn, the damping zeta is 0.9.
    """

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(tracking)

    def __init__(self, counts_per_turn: int, natural_frequency_rad_s: float) -> None:
        super().__init__()
        stiffness, damping = elementary.raised(natural_frequency_rad_s, 2), 2.0 * 0.9 * natural_frequency_rad_s
        self.k = TrackingConstants(rad_per_count(counts_per_turn), stiffness, damping)

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s."""
        return tracking(self.k, self, time_ns, count)


def _tracking(config: RigConfig) -> TrackingLoop:
    return TrackingLoop(config.encoders.counts_per_turn, config.estimator.natural_frequency_rad_s)


def _check(estimator: Mapping[str, Any], loop: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    """A loop too fast for the sample time oscillates; a few samples may be missing, too."""
    frequency = estimator.get("natural_frequency_rad_s", EstimatorConfig().natural_frequency_rad_s)
    rate_hz = loop.get("rate_hz", LoopConfig().rate_hz)
    if isinstance(frequency, int | float) and isinstance(rate_hz, int | float) and frequency > 0.1 * rate_hz:
        problem = f"{frequency!r}: must be at most a tenth of loop.rate_hz = {rate_hz!r}"
        yield ConfigIssue("estimator.natural_frequency_rad_s", problem)


SPEC: Final = EstimatorSpec(
    "A model wheel that follows the counted angle through a spring and a damper",
    (parameter("natural_frequency_rad_s", "rad/s", "quicker and noisier if higher; at most rate_hz/10"),),
    on_both_wheels(_tracking),
    TrackingLoop,
    _check,
)
