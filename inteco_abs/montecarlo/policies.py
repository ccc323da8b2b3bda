"""What decides on a simulated rig: the product's own estimators and controllers, or oracles that know the truth."""

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
from inteco_abs.signals import Command, Estimate, Sample

IDEAL: Final = "ideal"
"""Name of the estimator that knows the truth, as `estimator.name` of an ensemble's configuration."""
ESTIMATOR_NAMES: Final = (*ESTIMATORS, IDEAL)
"""Estimators that an ensemble's configuration may name."""


class TrueState:
    """True state of rig number `rig` of a batch, as it is now."""

    __slots__ = ("_batch", "_parameters", "_rig")

    def __init__(self, batch: BatchPlant, rig: int, variation: RigVariation) -> None:
        self._batch = batch
        self._rig = rig
        self._parameters = variation.parameters

    @property
    def wheel_speed(self) -> float:
        """Of the upper wheel, rad/s."""
        return self._batch.wheel_speed.item(self._rig)

    @property
    def road_speed(self) -> float:
        """Of the lower wheel, rad/s."""
        return self._batch.road_speed.item(self._rig)

    @property
    def slip(self) -> float:
        """In 0..1, equation (7)."""
        return wheel_slip(self.wheel_speed, self.road_speed, self._parameters)

    @property
    def wheel_angle(self) -> float:
        """Of the upper wheel, rad."""
        return self._batch.wheel_angle.item(self._rig)

    @property
    def brake_torque(self) -> float:
        """What the brake can hold, N m."""
        return self._batch.brake_torque.item(self._rig)


class IdealPolicy:
    """Estimator with the true speeds and slip, whatever the encoders count: the paper's simulation."""

    __slots__ = ("_state",)

    def __init__(self, state: TrueState) -> None:
        self._state = state

    def update(self, sample: Sample, command: Command = Command.SAFE) -> Estimate:  # noqa: ARG002  it looks at the rig
        """The truth at the instant of `sample`."""
        state = self._state
        return Estimate(state.wheel_speed, state.road_speed, state.slip, valid=True)


PolicyFactory = Callable[[RigVariation, TrueState], tuple[Estimator, Controller]]
"""Makes the estimator and controller of one rig, which may look at its true state at every sample.

Shards may run in other processes: a maker must be picklable, as a function of a module or a dataclass is.
"""


@dataclass(frozen=True, slots=True)
class ConfiguredPolicy:
    """Makes what the configuration names, as a run on the rig does; its estimator may also be `ideal`.

    Without `controllers`, all that are installed are known. A user's `file.py:Class` comes with its `source`: its class
    is unknown to another process.
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
