"""The plant's functions compiled, in loops over many rigs whose constants, states and commands are rows of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from inteco_abs.machine_code import compiled
from inteco_abs.rig.model import true_slip
from inteco_abs.rig.plant import move_on, read_encoders

Floats = NDArray[np.float64]


@compiled
def first_outside(duties: Floats) -> int:
    """Place of the first duty that is not in 0..1, or -1."""
    for i in range(duties.size):
        if not 0.0 <= duties[i] <= 1.0:
            return i
    return -1


@compiled
def advance(
    rigs: Any,
    states: Any,
    due_s: Floats,
    torques: Floats,
    drives: Floats,
    brakes: Floats,
    tick: int,
    duration_s: float,
) -> int:
    """Move all rigs on; the largest number of commands on their way to a brake.

    `drives` and `brakes` hold the duties of the newest ticks, a row each, those of `tick` in row `tick` modulo
    the number of rows.
    """
    most = 0
    for i in range(rigs.size):
        k, s = rigs[i], states[i]
        row = (tick - k.command_delay_ticks) % drives.shape[0]
        move_on(k, s, due_s[i], torques[i], drives[row, i], brakes[row, i], duration_s)
        most = max(most, s.sent - s.arrived)
    return most


@compiled
def slips(rigs: Any, states: Any, found: Floats) -> None:
    """Write every rig's slip to `found`."""
    for i in range(rigs.size):
        found[i] = true_slip(rigs[i], states[i])


@compiled
def read_all_encoders(rigs: Any, states: Any, reading: Any, wheel: NDArray[np.int64], road: NDArray[np.int64]) -> None:
    """Write every rig's counts to `wheel` and `road`, with the noise of that number of reading, 1 at first."""
    for i in range(rigs.size):
        wheel[i], road[i] = read_encoders(rigs[i], states[i], reading)
