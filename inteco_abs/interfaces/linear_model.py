"""The braking model linearised at a working point, for control toolboxes. Needs the extra `control`."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.control import BrakingModel
from inteco_abs.errors import AbsError
from inteco_abs.interfaces.symbolic_model import matrices
from inteco_abs.rig import RigParameters, brake_duty

Matrix = NDArray[np.float64]


class WorkingPoint(NamedTuple):
    """Where a model is linearised: the brake torque is the one that holds the slip."""

    slip: float
    wheel_speed_rad_s: float
    road_speed_rad_s: float
    brake_torque_nm: float
    brake: float
    """Duty in 0..1 that settles to this torque."""


@dataclass(frozen=True, slots=True)
class LinearModel:
    """dx' = A dx + B du, dy = C dx + D du: differences from a working point, in rad/s, N m, duty and slip."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    states: tuple[str, ...]
    """Names of the states: speeds of wheel and road and, for a brake with a lag, its torque."""
    point: WorkingPoint
    drift: Matrix
    """Derivatives of the states at the point itself: the slip stays, but the wheels slow down."""

    def to_control(self) -> Any:
        """As a `control.StateSpace` with named signals. Raises AbsError without python-control."""
        try:
            import control  # noqa: PLC0415  it loads matplotlib
        except ImportError as error:
            raise AbsError("a StateSpace needs python-control: pip install 'inteco-abs[control]'") from error
        parts = self.A, self.B, self.C, self.D
        return control.ss(*parts, states=list(self.states), inputs=["brake"], outputs=["slip"], name="braking")


def linearised(parameters: RigParameters, slip: float, road_speed: float) -> LinearModel:
    """The braking model at a `slip` in 0..1, both excluded, and a `road_speed` above 0 rad/s, while the brake holds it.

    The point is not an equilibrium, as the wheels slow down by `drift`: the model holds for times in which the road's
    speed changes little. The poles grow like 1/speed. With an infinite `c31` the torque is not a state. Raises
    ValueError for a point outside these ranges, and where the brake would need a duty outside `u0`..1 to hold the slip.
    """
    if not (0.0 < slip < 1.0 and 0.0 < road_speed < math.inf):
        point = f"slip {slip!r}, road speed {road_speed!r} rad/s"
        raise ValueError(f"{point}: the slip must be above 0 and below 1, the speed above 0 and finite")
    f, g = BrakingModel(parameters).terms(slip, road_speed)
    torque = -f / g
    duty = brake_duty(torque, parameters)
    if not parameters.u0 < duty <= 1.0:
        raise ValueError(
            f"slip {slip!r} at {road_speed!r} rad/s needs {torque:.3g} N m and so a duty of {duty:.3g}: the brake "
            f"gives {parameters.u0:g}..1; choose another point"
        )
    lag = math.isfinite(parameters.c31)
    wheel_speed = (1.0 - slip) * parameters.r2 / parameters.r1 * road_speed
    states = (wheel_speed, road_speed, torque)[: 3 if lag else 2]
    A, B, C, D, drift = (np.array(part, float) for part in matrices(lag=lag)(*astuple(parameters), *states, duty))
    names = ("wheel_speed_rad_s", "road_speed_rad_s", "brake_torque_nm")[: len(states)]
    return LinearModel(A, B, C, D, names, WorkingPoint(slip, wheel_speed, road_speed, torque, duty), drift[:, 0])
