"""Estimators and controllers of simulated rigs: configured ones, or oracles that know the true state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control import ESTIMATORS, Controller, Estimator, make_controller, make_estimator
from inteco_abs.montecarlo.batch import BatchPlant
from inteco_abs.plugins import Controllers, load_controller
from inteco_abs.rig import RigVariation, wheel_slip
from inteco_abs.rig.adhesion_curve import road_adhesion
from inteco_abs.signals import Command, Estimate, Sample

IDEAL: Final = "ideal"
"""`estimator.name` of the estimator that knows the true state; for Monte Carlo runs only."""
ESTIMATOR_NAMES: Final = (*ESTIMATORS, IDEAL)
"""Valid `estimator.name` in Monte Carlo runs."""


class TrueState:
    """Current true state of rig number `rig` of a batch."""

    __slots__ = ("_batch", "_parameters", "_rig")

    def __init__(self, batch: BatchPlant, rig: int, variation: RigVariation) -> None:
        self._batch = batch
        self._rig = rig
        self._parameters = variation.parameters

    @property
    def wheel_speed(self) -> float:
        """Speed of the upper wheel, rad/s."""
        return self._batch.wheel_speed.item(self._rig)

    @property
    def road_speed(self) -> float:
        """Speed of the lower wheel, rad/s."""
        return self._batch.road_speed.item(self._rig)

    @property
    def slip(self) -> float:
        """In 0..1, equation (7)."""
        return wheel_slip(self.wheel_speed, self.road_speed, self._parameters)

    @property
    def wheel_angle(self) -> float:
        """Angle of the upper wheel, rad."""
        return self._batch.wheel_angle.item(self._rig)

    @property
    def brake_torque(self) -> float:
        """Torque that the brake can hold, N m."""
        return self._batch.brake_torque.item(self._rig)

    @property
    def fade(self) -> float:
        """Share of a cold brake's torque, 0..1."""
        return float(self._batch.rig(self._rig)[1].fade)

    def adhesion(self, slip: float) -> float:
        """Adhesion of the road as it is now at `slip` in 0..1, without the load's ripple."""
        k, s = self._batch.rig(self._rig)
        return float(s.grip * road_adhesion(k, s, slip))


class IdealPolicy:
    """Estimator that returns the true speeds and slip, as in the paper's simulation."""

    __slots__ = ("_state",)

    def __init__(self, state: TrueState) -> None:
        self._state = state

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:  # noqa: ARG002  it looks at the rig
        """True speeds and slip at the time of `sample`."""
        state = self._state
        return Estimate(state.wheel_speed, state.road_speed, state.slip, valid=True)


PolicyFactory = Callable[[RigVariation, TrueState], tuple[Estimator, Controller]]
"""Makes the estimator and controller of one rig, which may read its true state.

It must be picklable, as shards run in other processes: a function of a module, or a dataclass.
"""


@dataclass(frozen=True, slots=True)
class ConfiguredPolicy:
    """PolicyFactory of a configuration, as for a run on the rig; its estimator may also be `ideal`.

    Without `controllers`, all installed ones are known. A user's `file.py:Class` needs its `source`, as another process
    does not know the class.
    """

    config: RigConfig
    controllers: Mapping[str, type[Controller]] | None = None
    source: bytes = b""

    def __call__(self, variation: RigVariation, state: TrueState) -> tuple[Estimator, Controller]:  # noqa: ARG002  a maker
        """Estimator and controller of one rig. Raises ConfigError if the controller cannot be made."""
        name = self.config.controller.name
        controllers = {name: _loaded(name, self.source)} if self.source else self.controllers or _installed()
        estimator = IdealPolicy(state) if self.config.estimator.name == IDEAL else make_estimator(self.config)
        return estimator, make_controller(self.config, controllers)


@cache
def _installed() -> Controllers:
    return Controllers()


@cache
def _loaded(name: str, source: bytes) -> type[Controller]:
    kind, _ = load_controller(name, source)
    return kind
