"""A stop of a simulated rig that waits for an action every few ticks; the same functions in Python and compiled.

A tick reads, estimates and decides, and what was decided takes the rig's own delay, as in a loop and, with the same
bits, in Monte Carlo runs. Between estimate and decision the stop waits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from typing import Any, Final, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from inteco_abs.config import RigConfig
from inteco_abs.control import (
    Controller,
    Estimator,
    Function,
    Guard,
    PhaseMachine,
    advance_and_admit,
    config_of_stop,
    function_of,
    make_estimator,
)
from inteco_abs.rig import LONGEST_DEAD_TIME_S, MOST_DELAY_TICKS, RigVariation
from inteco_abs.rig.brake_actuator import settled
from inteco_abs.rig.model import true_slip
from inteco_abs.rig.plant import move_on, read_encoders
from inteco_abs.rig.state import Constants, State
from inteco_abs.sessions import STANDSTILL_RAD_S
from inteco_abs.signals import Command, Estimate, Phase, Reason, Sample

_NONE: Final = Reason.NONE
_NO_FLAGS: Final[Any] = 0
_SPIN_UP, _BRAKING = Phase.SPIN_UP, Phase.BRAKING


class Ending(IntEnum):
    """Whether a stop is over, and why."""

    NOT_YET = 0
    STANDING = 1
    """The road wheel is at rest."""
    TRIPPED = 2
    """The guard, or a time limit of the experiment, has switched the outputs off."""
    OUT_OF_TIME = 3


_NOT_YET, _STANDING = Ending.NOT_YET, Ending.STANDING
_TRIPPED, _OUT_OF_TIME = Ending.TRIPPED, Ending.OUT_OF_TIME


@dataclass(frozen=True, slots=True)
class Clock:
    """Times of a stop."""

    period_ns: int
    ticks_per_action: int
    longest: int
    """Ticks that braking may take."""


@dataclass(slots=True)
class StopState:
    """Where a stop is."""

    due_s: list[float]
    """Of the commands that are on their way through the brake's dead time, as are the `torques`."""
    torques: list[float]
    drives: list[float]
    """Duties that were decided, as are the `brakes`: each acts the rig's delay later."""
    brakes: list[float]
    tick: int = 0
    began: int = -1
    """Tick at which braking began, or -1."""
    wheel_count: int = 0
    road_count: int = 0
    wheel_speed: float = 0.0
    """As estimated, rad/s; so are `road_speed` and `slip`."""
    road_speed: float = 0.0
    slip: float = 0.0
    true_slip: float = 0.0
    ending: int = 0


class Parts(NamedTuple):
    """Constants and state of a rig, of its decision path, and of its stop."""

    rig_k: Any
    rig: Any
    estimator_k: Any
    estimator: Any
    machine_k: Any
    machine: Any
    guard_k: Any
    guard: Any
    clock: Any
    stop: Any


def observe(parts: Parts, estimate: Function, word: Callable[[int], int]) -> None:
    """Read the encoders and estimate; `word` makes the number of a reading one of 64 bits without a sign."""
    clock, stop, guard = parts.clock, parts.stop, parts.guard
    wheel, road = read_encoders(parts.rig_k, parts.rig, word(stop.tick + 1))
    stop.wheel_count, stop.road_count = wheel, road
    sample = Sample(stop.tick, stop.tick * clock.period_ns, clock.period_ns / 1e9, wheel, road, _NO_FLAGS)
    estimated = estimate(parts.estimator_k, parts.estimator, sample, Command(guard.drive, guard.brake))
    stop.wheel_speed, stop.road_speed, stop.slip = (
        estimated.wheel_speed_rad_s,
        estimated.road_speed_rad_s,
        estimated.slip,
    )
    stop.true_slip = true_slip(parts.rig_k, parts.rig)


def respond(parts: Parts, brake: float) -> None:
    """Decide on what was read, with this duty as the demand, and move on by a tick."""
    k, clock, stop, machine, guard = parts.rig_k, parts.clock, parts.stop, parts.machine, parts.guard
    tick, period_s = stop.tick, clock.period_ns / 1e9
    sample = Sample(tick, tick * clock.period_ns, period_s, stop.wheel_count, stop.road_count, _NO_FLAGS)
    advance_and_admit((parts.machine_k, parts.guard_k), (machine, guard), sample, brake, _NONE)
    if stop.began < 0 and machine.phase == _BRAKING:
        stop.began = tick
    places = k.command_delay_ticks + 1
    stop.drives[tick % places], stop.brakes[tick % places] = guard.drive, guard.brake
    acting = (tick + 1) % places  # decided the delay ago
    move_on(k, parts.rig, stop.due_s, stop.torques, stop.drives[acting], stop.brakes[acting], period_s)
    stop.tick = tick + 1


def run_up(parts: Parts, brake: float, observe: Function) -> None:
    """Drive until braking has begun and the first decision is due, or until the guard ends it.

    A demand is of no effect meanwhile.
    """
    observe(parts)
    while parts.machine.phase == _SPIN_UP:
        respond(parts, brake)
        observe(parts)
    if parts.guard.reason != _NONE:
        parts.stop.ending = _TRIPPED


def act(parts: Parts, brake: float, observe: Function) -> None:
    """Demand this duty for the ticks of an action, or until the stop is over."""
    clock, stop, machine = parts.clock, parts.stop, parts.machine
    for _ in range(clock.ticks_per_action):
        respond(parts, brake)
        observe(parts)
        if parts.guard.reason != _NONE:
            stop.ending = _TRIPPED
        elif machine.phase != _BRAKING or parts.rig.road_speed < STANDSTILL_RAD_S:
            stop.ending = _STANDING
        elif stop.tick - stop.began >= clock.longest:
            stop.ending = _OUT_OF_TIME
        if stop.ending != _NOT_YET:
            return


def make_rig(rig: RigVariation, rolling_rad_s: float) -> tuple[Constants, State]:
    """Constants and state of a rig, with the wheels rolling with the road at that speed."""
    k = Constants.of(rig)
    released = settled(k, 0.0)
    wheel_speed = k.r2 / k.r1 * rolling_rad_s
    return k, State.at_speeds(k, wheel_speed, rolling_rad_s, released)


def make_path(config: RigConfig, clock: Clock) -> tuple[Any, ...]:
    """All other parts of a stop with this configuration, which begins with the run-up."""
    estimator = make_estimator(config)
    machine = PhaseMachine(config, cast(Controller, None), Phase.SPIN_UP)  # actions are what a controller would demand
    guard = Guard(config)
    room = math.ceil(LONGEST_DEAD_TIME_S * 1e9 / clock.period_ns) + 2
    places = MOST_DELAY_TICKS + 1
    stop = StopState([0.0] * room, [0.0] * room, [0.0] * places, [0.0] * places)
    return getattr(estimator, "k", None), estimator, machine.k, machine, guard.k, guard, clock, stop


class Stops(Protocol):
    """Stops of several rigs, each begun and moved on on its own."""

    def begin(self, place: int, rig: RigVariation) -> None:
        """Drive this rig until its first decision is due."""
        ...

    def act(self, places: list[int], brakes: list[float]) -> None:
        """Demand these duties of the rigs at these places for the ticks of an action, or until a stop is over."""
        ...

    def column(self, part: str, name: str) -> NDArray[Any]:
        """One field of a part of each stop, not to be written to."""
        ...


class PythonStops:
    """Stops in Python, with any estimator."""

    def __init__(self, config: RigConfig, clock: Clock, count: int, rolling_rad_s: float) -> None:
        self._config, self._clock, self._rolling_rad_s = config, clock, rolling_rad_s
        estimate = function_of(make_estimator(config)) or _updated
        self._observe = partial(observe, estimate=estimate, word=_as_it_is)
        self._parts: list[Parts] = [self._make(RigVariation())] * count

    def _make(self, rig: RigVariation) -> Parts:
        return Parts(*make_rig(rig, self._rolling_rad_s), *make_path(config_of_stop(self._config, rig), self._clock))

    def begin(self, place: int, rig: RigVariation) -> None:
        """Drive this rig until its first decision is due."""
        self._parts[place] = self._make(rig)
        run_up(self._parts[place], 0.0, self._observe)

    def act(self, places: list[int], brakes: list[float]) -> None:
        """Demand these duties of the rigs at these places for the ticks of an action, or until a stop is over."""
        for place, brake in zip(places, brakes, strict=True):
            act(self._parts[place], brake, self._observe)

    def column(self, part: str, name: str) -> NDArray[Any]:
        """One field of a part of each stop."""
        return np.array([getattr(getattr(parts, part), name) for parts in self._parts])


def _updated(k: Any, s: Estimator, sample: Sample, command: Command) -> Estimate:  # noqa: ARG001  an estimator of any class
    return s.update(sample, command)


def _as_it_is(number: int) -> int:
    return number
