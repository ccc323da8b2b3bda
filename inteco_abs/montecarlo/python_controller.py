"""A controller without a function, called by compiled stops: its update alone runs in Python."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from inteco_abs.control import Controller, demand_of
from inteco_abs.signals import BrakeDemand, Estimate, Prediction

_NUMBERS: Final = 6 + len(Prediction._fields)
"""Wheel and road speed, slip, validity, time since the last sample, whether there is a prediction, and that."""
_UPDATE: Final = ctypes.CFUNCTYPE(ctypes.c_double, *[ctypes.c_double] * _NUMBERS)
_NO_PREDICTION: Final = (0.0,) * (1 + len(Prediction._fields))
_SWITCHING: Final = (-1.0,) * _NUMBERS
"""Asks for the switching variable of the last demand: no estimate has a validity of -1."""


@dataclass(frozen=True, slots=True)
class _Constants:
    address: int
    """Address of the function to call with _NUMBERS, which returns the brake's duty, or with _SWITCHING."""


@dataclass(slots=True)
class _State:
    """Nothing, as the controller keeps its own; a record has at least one field."""

    unused: int = 0


def _code_of_call(_context: Any, address: Any, numbers: Any) -> Any:
    """Type and machine code of a call of the function at an address with a tuple of numbers."""

    def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        double = ir.DoubleType()
        kind = ir.FunctionType(double, [double] * numbers.count).as_pointer()
        given = [builder.extract_value(arguments[1], i) for i in range(numbers.count)]
        return builder.call(builder.inttoptr(arguments[0], kind), given)

    return types.float64(address, numbers), code


_call: Final[Any] = intrinsic(_code_of_call)


def _ask(k: _Constants, _s: _State, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Demand of the controller: its duty and switching variable, as a stop needs nothing else."""
    wheel_speed, road_speed, slip, valid, outlook = estimate
    numbers = wheel_speed, road_speed, slip, 1.0 if valid else 0.0, dt_s
    brake = _call(k.address, numbers + _flat(outlook))
    return BrakeDemand(brake, 0.0, _call(k.address, _SWITCHING), (0.0, 0.0, 0.0, 0.0))


def _flat(seen: Prediction | None) -> tuple[float, ...]:
    if seen is None:
        return _NO_PREDICTION
    x1, x2 = seen.wheel_angle_rad, seen.wheel_speed_rad_s
    brake = seen.lagged_torque_nm, seen.excess_torque_nm
    adhesion = seen.adhesion_factor, seen.ripple_cosine, seen.ripple_sine
    times = seen.brake_dead_time_s, seen.brake_lag_s
    release = seen.brake_release_ratio, seen.slowest_release_ratio
    return (1.0, x1, x2, seen.road_speed_rad_s, *brake, *adhesion, *times, *release)


class PythonController(_State):
    """`controller` as a part of a compiled stop, which lives no longer than this object.

    It asks for NaN where the controller raises something, and keeps that.
    """

    function = staticmethod(_ask)

    def __init__(self, controller: Controller) -> None:
        super().__init__()
        self._controller = controller
        self._switching = 0.0
        self.error: BaseException | None = None
        """What the controller raised."""
        self._update = _UPDATE(self._answer)  # ctypes frees the code of a function that nothing refers to
        self.k = _Constants(ctypes.cast(self._update, ctypes.c_void_p).value or 0)

    def _answer(self, *numbers: float) -> float:
        if numbers == _SWITCHING:
            return self._switching
        try:
            wheel_speed, road_speed, slip, valid, dt_s, predicted, *prediction = numbers
            outlook = Prediction(*prediction) if predicted else None
            estimate = Estimate(wheel_speed, road_speed, slip, valid > 0.0, outlook)
            demand = demand_of(self._controller, estimate, dt_s)
        except BaseException as error:  # noqa: BLE001  ctypes would print and forget it
            self.error = error
            return math.nan
        self._switching = demand.switching
        return demand.brake
