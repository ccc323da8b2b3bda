"""How a law reaches the reference slip on its nominal rig, with an ideal brake: no lag, no noise."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, NamedTuple

from inteco_abs.config import RigConfig
from inteco_abs.control import CONTROLLERS, Setup, gains_in_force
from inteco_abs.rig import Plant, RigParameters, nominal_parameters
from inteco_abs.signals import Estimate

_LONGEST_S: Final = 10.0
_STRONG_NM: Final = 10_000.0


class Reaching(NamedTuple):
    """Reaching the reference from one slip at the start of braking."""

    from_slip: float
    bound_s: float
    """Time by (20), s; infinite without a constant rate."""
    time_s: float
    """Simulated time with the brake's limits, s; infinite if the road gets too slow before."""
    lowest_torque_nm: float
    """Smallest torque that the law demands of a brake without an upper limit."""
    peak_torque_nm: float
    """Largest torque that it demands."""


def reaching(config: RigConfig, from_slip: float, width: float, bound_s: float) -> Reaching:
    """Simulate until the slip error changes its sign or is within `width`, with and without the brake's limit."""
    nominal = nominal_parameters(config.model)
    strong = replace(nominal, b1=_STRONG_NM, b2=0.0, u0=0.0)  # the duty stays below 1, so there is no limit
    _, asked_nm = _way(config, strong, 1.0, from_slip, width)
    time_s, _ = _way(config, nominal, config.guard.brake_limit, from_slip, width)
    return Reaching(from_slip, bound_s, time_s, min(asked_nm), max(asked_nm))


def _way(
    config: RigConfig, parameters: RigParameters, duty_limit: float, from_slip: float, width: float
) -> tuple[float, list[float]]:
    """Time to the reference in s, and the torques demanded in N m."""
    reference, hold_below = config.controller.reference_slip, config.controller.hold_below_rad_s
    make: Any = CONTROLLERS[config.controller.name]  # each controller's constructor takes its own gains
    law = make(Setup(reference, parameters, hold_below), **gains_in_force(config))
    start = config.experiment.start_speed_rad_s
    rim_ratio = (1.0 - from_slip) * parameters.r2 / parameters.r1
    plant = Plant(replace(parameters, c31=math.inf), rim_ratio * start, start)
    side = math.copysign(1.0, from_slip - reference)
    period_s, asked_nm = config.period_ns * 1e-9, [0.0]  # the brake is released before
    while side * (plant.slip - reference) > width:
        if plant.road_speed <= hold_below or plant.time_s > _LONGEST_S:
            return math.inf, asked_nm
        demand = law.update(Estimate(plant.wheel_speed, plant.road_speed, plant.slip, valid=True), period_s)
        asked_nm.append(demand.torque_nm)
        plant.advance(0.0, min(demand.brake, duty_limit), period_s)
    return plant.time_s, asked_nm
