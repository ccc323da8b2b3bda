"""Thousands of rigs at once, each exactly as the scalar plant moves it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inteco_abs.montecarlo import kernel
from inteco_abs.montecarlo.kernel import Floats
from inteco_abs.rig import DriveMotor, RigVariation
from inteco_abs.rig.state import Constants
from inteco_abs.rig_rows import rig_rows, state_rows

Counts = NDArray[np.int64]

_ON_THE_WAY: Final = 64
"""Commands of one rig for which there is room at first: a dead time of 20 ms at 2 kHz has 40 under way."""


class BatchPlant:
    """The rigs of `variations`, started at the given road speeds in rad/s with the brake released.

    The wheels roll without slip where `wheel_speed` is not given. Every argument and result has one entry per rig,
    in their order; a single number, or motor, stands for all. The state arrays are views that move on with the rigs:
    copy what is to be kept. The physics is that of `Plant`, at the same steps; each call of `advance` is one tick for
    the `command_delay_ticks` of the variations. The compiled steps hold no lock, so that shards may run in threads.
    """

    def __init__(
        self,
        variations: Sequence[RigVariation],
        road_speed: float | Floats = 180.0,
        wheel_speed: float | Floats | None = None,
        motor: DriveMotor | Sequence[DriveMotor] | None = None,
        *,
        max_step_s: float = 0.0005,
    ) -> None:
        if not variations:
            raise ValueError("no variations: a batch needs at least one rig")
        if not 0.0 < max_step_s < math.inf:
            raise ValueError(f"max_step_s = {max_step_s!r}: must be finite and above 0 s")
        if motor is None or isinstance(motor, DriveMotor):
            motor = [motor or DriveMotor()] * len(variations)
        rigs = [Constants.of(rig, own, max_step_s) for rig, own in zip(variations, motor, strict=True)]
        self._rigs = rig_rows(rigs)
        if wheel_speed is None:
            wheel_speed = self._rigs["r2"] / self._rigs["r1"] * road_speed
        if not (np.isfinite(wheel_speed).all() and np.isfinite(road_speed).all()):
            raise ValueError("wheel_speed and road_speed: must be finite")
        starts = np.empty((2, len(rigs)))
        starts[0], starts[1] = wheel_speed, road_speed
        self._states = state_rows(rigs, *starts)
        rows = 1 + int(self._rigs["command_delay_ticks"].max())
        self._drives, self._brakes = np.zeros((2, rows, len(variations)))
        self._due_s, self._torques = np.zeros((2, len(rigs), _ON_THE_WAY))
        self._tick = 0
        self._readings = 0
        self.time_s = 0.0
        """Time in s since the start."""
        self.wheel_speed = self._view("wheel_speed")
        """Speeds of the upper wheels, rad/s."""
        self.road_speed = self._view("road_speed")
        """Speeds of the lower wheels, rad/s."""
        self.brake_torque = self._view("brake_torque")
        """What the brakes can hold, N m."""
        self.wheel_angle = self._view("wheel_angle")
        """Angles of the upper wheels, rad."""
        self.road_angle = self._view("road_angle")
        """Angles of the lower wheels, rad."""

    def __len__(self) -> int:
        return len(self._rigs)

    @property
    def slip(self) -> Floats:
        """Slips in 0..1, equation (7); a new array."""
        found = np.empty(len(self))
        kernel.slips(self._rigs, self._states, found)
        return found

    def advance(self, drive: float | Floats, brake: float | Floats, duration_s: float) -> None:
        """Move on by `duration_s` >= 0 with constant duties in 0..1; raises ValueError outside, and nothing moves."""
        if not 0.0 <= duration_s < math.inf:
            raise ValueError(f"duration_s = {duration_s!r}: must be finite and not negative")
        row = self._tick % len(self._drives)
        for name, wanted, rows in (("drive", drive, self._drives), ("brake", brake, self._brakes)):
            rows[row] = wanted
            outside = kernel.first_outside(rows[row])
            if outside >= 0:
                raise ValueError(f"{name} of rig {outside} is {rows[row, outside]!r}: duties must be in 0..1")
        most = kernel.advance(
            self._rigs,
            self._states,
            self._due_s,
            self._torques,
            self._drives,
            self._brakes,
            self._tick,
            duration_s,
        )
        if most == self._due_s.shape[1]:  # at its number modulo the new length each command is where it was
            self._due_s, self._torques = np.tile(self._due_s, 2), np.tile(self._torques, 2)
        self._tick += 1
        self.time_s += duration_s

    def read_encoders(self) -> tuple[Counts, Counts]:
        """Counts of wheels and roads now, new arrays: one reading, with its noise, as by `Encoder.read`."""
        wheel, road = np.empty((2, len(self)), np.int64)
        self._readings += 1
        kernel.read_all_encoders(self._rigs, self._states, np.uint64(self._readings), wheel, road)
        return wheel, road

    def rig(self, i: int) -> tuple[Any, Any]:
        """Constants and state of one rig, for compiled functions."""
        return self._rigs[i], self._states[i]

    def _view(self, name: str) -> Floats:
        view: Floats = self._states[name]
        view.flags.writeable = False
        return view
