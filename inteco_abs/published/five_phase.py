"""The five-phase hybrid of production anti-lock brakes.

W. Pasillas-Lepine: Hybrid modeling and limit cycle analysis for a class of five-phase anti-lock brake algorithms,
Vehicle System Dynamics 44 (2), 2006, 173-188; M. Gerard, W. Pasillas-Lepine, E. de Vries, M. Verhaegen: Adaptation
of hybrid five-phase ABS algorithms for experimental validation, IFAC Symposium Advances in Automotive Control,
Munich 2010.

It switches by the wheel's acceleration alone: the pressure rises until the wheel falls back (1), is held until it
falls faster (2), drops until it recovers (3), is held while it runs up (4), and rises again as it slows (5). It makes
a limit cycle around the adhesion's peak and has no reference; the slip error of a table says how far from 0.2 it
cycles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from inteco_abs.control import Gain
from inteco_abs.published.base import PublishedLaw, PublishedState, demand
from inteco_abs.quantities import Quantity
from inteco_abs.signals import BrakeDemand, Estimate


@dataclass(slots=True)
class PhasesState(PublishedState):
    duty: float = 0.4
    """At first where the brake's torque begins."""
    phase: float = 1.0
    wheel: float = 0.0
    """Filtered speed, rad/s."""
    road: float = 0.0
    started: bool = False


def five_phase(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Rise, hold or drop, by the wheel's acceleration beyond the road's."""
    wheel, road, slip, _, _ = estimate
    if not s.started:
        s.wheel, s.road, s.started = wheel, road, True
    wheel_rate, road_rate = k.filter_rad_s * (wheel - s.wheel), k.filter_rad_s * (road - s.road)
    s.wheel += wheel_rate * dt_s
    s.road += road_rate * dt_s
    beyond = wheel_rate - road_rate * k.model.ratio
    if s.phase in (1.0, 5.0) and beyond < -k.first:
        s.phase = 2.0
    if s.phase == 2.0 and beyond < -k.second:
        s.phase = 3.0
    elif s.phase == 2.0 and beyond > 0.0:
        s.phase = 5.0
    if s.phase == 3.0 and beyond > 0.0:
        s.phase = 4.0
    if s.phase == 4.0 and beyond < k.recovered:
        s.phase = 5.0
    if s.phase == 1.0:
        s.duty += k.rise_per_s * dt_s
    elif s.phase == 3.0:
        s.duty -= k.drop_per_s * dt_s
    elif s.phase == 5.0:
        s.duty += k.slow_rise_per_s * dt_s
    s.duty = min(max(s.duty, 0.0), 1.0)
    return demand(s.duty, 0.0, slip - s.reference, s.phase)


class FivePhase(PublishedLaw, PhasesState):
    """The five-phase hybrid of production ABS (Pasillas-Lepine 2006), which switches by the wheel's acceleration."""

    gains = (
        Gain("first", 100.0, 0.0, 1e5, "rad/s2", "deceleration beyond the road's that ends a rise"),
        Gain("second", 200.0, 0.0, 1e5, "rad/s2", "deceleration that begins the drop"),
        Gain("recovered", 50.0, 0.0, 1e5, "rad/s2", "acceleration below which the pressure rises again"),
        Gain("rise_per_s", 3.0, 0.0, 100.0, "1/s", "of the duty at first"),
        Gain("slow_rise_per_s", 0.3, 0.0, 100.0, "1/s", "of the duty later"),
        Gain("drop_per_s", 3.0, 0.0, 100.0, "1/s", "of the duty"),
        Gain("filter_rad_s", 100.0, 1.0, 1000.0, "rad/s", "of the filter of both speeds"),
    )
    internals = (Quantity("phase", "1", "number of the phase"),)
    function = staticmethod(five_phase)
