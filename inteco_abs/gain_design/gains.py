"""The gains in equations (20) to (26)."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import gains_in_force, reaching_time_bound
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design.bounds import Floats

LAWS: Final = ("reaching-law", "constant-rate", "boundary-layer")
"""Controllers with a switching gain."""


class Gains(NamedTuple):
    """Gains of a law, 0 for those that it does not have; without the integral gain of `boundary-layer`."""

    Mk: float
    Mq: float
    v: float
    width: float

    def grown(self, speeds: Floats) -> Floats:
        """Factor on Mq over road speed."""
        return np.maximum(1.0, self.v / speeds)

    def switching(self, speeds: Floats) -> Floats:
        """Mq in force over road speed, 1/s."""
        return self.Mq * self.grown(speeds)

    def time_bound(self, slip: float, reference: float) -> float:
        """Equation (20) in s, to the boundary layer if there is one; infinite without a constant rate."""
        error, Mk, Mq = abs(slip - reference), self.Mk, self.Mq
        if error <= self.width:
            return 0.0
        if Mq == 0.0:
            return math.inf
        if Mk == 0.0:
            return (error - self.width) / Mq
        return reaching_time_bound(error, 0.0, Mk, Mq) - reaching_time_bound(self.width, 0.0, Mk, Mq)


def gains_of(config: RigConfig) -> Gains:
    """The gains in force of one of `LAWS`; raises ConfigError for another controller."""
    name = config.controller.name
    if name not in LAWS:
        problem = f"{name!r} has no switching gain for (25) to judge: must be one of {', '.join(LAWS)}"
        raise ConfigError.of("controller.name", problem)
    gains = gains_in_force(config)
    return Gains(*(gains.get(gain, 0.0) for gain in Gains._fields))
