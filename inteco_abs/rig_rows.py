"""Rigs and their states as rows of arrays, for the compiled plant: every name as in `Constants` and `State`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, fields
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inteco_abs.records import row_fields
from inteco_abs.rig import EncoderVariation
from inteco_abs.rig.brake_actuator import settled
from inteco_abs.rig.state import Constants, State

Rows = NDArray[np.void]

_DISC: Final = np.dtype([(field.name, np.float64) for field in fields(EncoderVariation)])
_TYPES: Final = {"int": np.int64, "Word": np.uint64, "bool": np.bool_, "EncoderVariation": _DISC}
_OWN_TYPES: Final = {"brake_pwm_steps": np.float64}


def _row_type(kind: type[Any]) -> np.dtype[np.void]:
    columns = [
        (field.name, _OWN_TYPES.get(field.name, _TYPES.get(str(field.type), np.float64))) for field in row_fields(kind)
    ]
    return np.dtype(columns, align=True)


RIG: Final = _row_type(Constants)
STATE: Final = _row_type(State)
_VALUES: Final = attrgetter(*(RIG.names or ()))


def rig_rows(rigs: Sequence[Constants]) -> Rows:
    """One row of type RIG for each rig."""
    rows = [[astuple(v) if isinstance(v, EncoderVariation) else v for v in _VALUES(k)] for k in rigs]
    return np.array([tuple(row) for row in rows], RIG).view(np.recarray)


def state_rows(rigs: Sequence[Constants], wheel_speeds: NDArray[np.float64], road_speeds: NDArray[np.float64]) -> Rows:
    """Rows of type STATE, at the given speeds in rad/s with the brake released."""
    states = []
    for k, wheel_speed, road_speed in zip(rigs, wheel_speeds, road_speeds, strict=True):
        released = settled(k, 0.0)
        state = State.at_speeds(k, wheel_speed, road_speed, released)
        states.append(astuple(state)[::-1])
    return np.array(states, STATE).view(np.recarray)
