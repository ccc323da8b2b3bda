"""Shared closed loops: the physics of the rig around the decision path, in virtual time."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import pytest

from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import (
    ESTIMATORS,
    BrakingModel,
    Pipeline,
    ReachingLaw,
    Setup,
    build_pipeline,
    control_check,
    preferred_estimator,
    reaching_law_torque,
)
from inteco_abs.control.estimators import Observer
from inteco_abs.rig import Encoder, Plant, RigParameters, RigVariation, brake_duty, brake_torque
from inteco_abs.signals import BoardFlags, Command, Estimate, Phase, Reason, Sample, Tick

REFERENCE = 0.2
START_RAD_S = 180.0
HOLD_BELOW_RAD_S = 5.0
LONGEST_STOP_S = 6.0
SETTLE_S = 0.020
COAST_TICKS = 200
FIRST_NS = 5_000_000_000_000  # a monotonic clock does not begin at 0
FIRST_COUNTS = (1000, -3000)  # nor need counts


class Row(NamedTuple):
    """One control instant of a stop from 180 rad/s; the torque is what was asked for from this instant on."""

    time_s: float
    wheel_angle: float
    road_angle: float
    road_speed: float
    slip: float
    torque: float

    @property
    def error(self) -> float:
        return self.slip - REFERENCE


class Stop(NamedTuple):
    rows: list[Row]
    stop_s: float
    distance_m: float

    @property
    def reached_s(self) -> float:
        return next(row.time_s for row in self.rows if row.error >= 0.0)

    @property
    def settled(self) -> list[Row]:
        since = self.reached_s + SETTLE_S
        return [row for row in self.rows if row.time_s >= since and row.road_speed > 10.0]

    @property
    def slip_rms(self) -> float:
        return math.sqrt(sum(row.error**2 for row in self.settled) / len(self.settled))

    @property
    def variation_nm_per_s(self) -> float:
        torques = [row.torque for row in self.rows if row.road_speed > 10.0]
        last_s = max(row.time_s for row in self.rows if row.road_speed > 10.0)
        return sum(abs(b - a) for a, b in pairwise(torques)) / last_s

    def mean_slip(self, low: float, high: float) -> float:
        slips = [row.slip for row in self.rows if low < row.road_speed < high]
        return sum(slips) / len(slips)


def _scaled_friction(parameters: RigParameters, factor: float) -> RigParameters:
    k = parameters
    return replace(k, w1=k.w1 * factor, w2=k.w2 * factor, w3=k.w3 * factor, w4=k.w4 * factor)


def _brake_to_rest(plant: Plant, period_s: float, duty_of: Callable[[Plant], float]) -> Stop:
    """Ask `duty_of` every period while the road turns faster than 5 rad/s, then hold the last duty to standstill."""
    rows, duty = [], 0.0
    while plant.road_speed > 0.0 and plant.time_s < LONGEST_STOP_S:
        if plant.road_speed > HOLD_BELOW_RAD_S:
            duty = duty_of(plant)
        torque = brake_torque(duty, plant.parameters)
        rows.append(Row(plant.time_s, plant.wheel_angle, plant.road_angle, plant.road_speed, plant.slip, torque))
        plant.advance(0.0, duty, period_s)
    return Stop(rows, plant.time_s, plant.road_angle * plant.parameters.r2)


def _rolling_plant(parameters: RigParameters) -> Plant:
    return Plant(parameters, parameters.r2 / parameters.r1 * START_RAD_S, START_RAD_S)


@cache
def _ideal_stop(
    Mk: float = 2.0,
    Mq: float = 1.0,
    period_s: float = 0.0005,
    duty_limit: float = 1.0,
    friction: float = 1.0,
    name: str = "mask",
) -> Stop:
    nominal = RigParameters.named(name)
    model = BrakingModel(nominal)

    def duty_of(plant: Plant) -> float:
        torque = reaching_law_torque(plant.slip, plant.road_speed, REFERENCE, Mk, Mq, model)
        return min(duty_limit, brake_duty(torque, nominal))

    true = _scaled_friction(replace(nominal, c31=math.inf), friction)
    return _brake_to_rest(_rolling_plant(true), period_s, duty_of)


@cache
def _estimated_stop(
    settings: tuple[str, ...] = (), Mk: float = 2.0, Mq: float = 1.0, *, lag: bool = True, phase: float = 0.0
) -> Stop:
    config = load_config(settings=settings, checks=[control_check()])
    nominal = RigParameters.named("mask")
    controller = ReachingLaw(Setup(REFERENCE, nominal, HOLD_BELOW_RAD_S), Mk, Mq)
    estimator = ESTIMATORS[config.estimator.name](config, nominal)
    plant = _rolling_plant(nominal if lag else replace(nominal, c31=math.inf))
    counts_per_rad, period_s = config.encoders.counts_per_turn / (2.0 * math.pi), config.period_ns * 1e-9
    ticks = iter(range(10**6))

    def sample(wheel_angle: float, road_angle: float) -> Sample:
        tick = next(ticks)
        wheel_count = math.floor(wheel_angle * counts_per_rad + phase)
        road_count = math.floor(road_angle * counts_per_rad + 2.0 * phase)
        return Sample(tick, tick * config.period_ns, period_s, wheel_count, road_count)

    for before in range(COAST_TICKS, 0, -1):
        elapsed_s = -before * period_s
        estimator.update(sample(plant.wheel_speed * elapsed_s, plant.road_speed * elapsed_s))

    def duty_of(plant: Plant) -> float:
        estimate = estimator.update(sample(plant.wheel_angle, plant.road_angle))
        return controller.update(estimate, period_s).brake

    return _brake_to_rest(plant, period_s, duty_of)


@pytest.fixture(scope="session")
def ideal_stop():
    """Stop with true speeds, a brake without lag, and the plant that the law believes in."""
    return _ideal_stop


@pytest.fixture(scope="session")
def estimated_stop():
    """Stop with encoder counts and an estimator in the loop."""
    return _estimated_stop


class Encoders:
    """Samples of two wheels that turn at given speeds, counted by ideal encoders."""

    def __init__(self, counts_per_turn: int = 2048, rate_hz: float = 2000.0) -> None:
        self.period_s = 1.0 / rate_hz
        self._counts_per_rad = counts_per_turn / (2.0 * math.pi)
        self._tick = -1
        self._time_ns = FIRST_NS
        self._angles = [0.0, 0.0]
        self._shown = FIRST_COUNTS

    def turn(self, wheel_speed: float, road_speed: float, *, periods: float = 1.0, stale: bool = False) -> Sample:
        """Next sample, `periods` after the last one; a stale one shows the counts of the last good one."""
        dt_s = self.period_s * periods
        self._tick += 1
        self._time_ns += round(dt_s * 1e9)
        self._angles[0] += wheel_speed * dt_s
        self._angles[1] += road_speed * dt_s
        if not stale:
            wheel, road = (math.floor(angle * self._counts_per_rad) for angle in self._angles)
            self._shown = (FIRST_COUNTS[0] + wheel, FIRST_COUNTS[1] + road)
        flags = BoardFlags.STALE if stale else BoardFlags.NONE
        return Sample(self._tick, self._time_ns, dt_s, *self._shown, flags)

    def roll(self, road_speed: float) -> Sample:
        """Both wheels with the same rim speed."""
        return self.turn(road_speed * 0.099 / 0.0995, road_speed)


@pytest.fixture(scope="session")
def encoders():
    """Maker of scripted encoders."""
    return Encoders


class Moment(NamedTuple):
    """One tick of an experiment, and the truth at that instant."""

    tick: Tick
    wheel_speed: float
    road_speed: float
    slip: float


def _nothing(sample: Sample, _phase: Phase) -> Sample:
    return sample


class Experiment:
    """A whole run, spin-up to standstill: the plant, its encoders and a pipeline, output first."""

    def __init__(self, config: RigConfig, pipeline: Pipeline | None = None) -> None:
        self.config = config
        self.pipeline = build_pipeline(config) if pipeline is None else pipeline
        self.plant = Plant(RigParameters.named(config.simulation.parameters), 0.0, 0.0)

    def moments(
        self,
        tamper: Callable[[Sample, Phase], Sample] = _nothing,
        stop_when: Callable[[Phase], bool] = lambda _phase: False,
        periods: Callable[[int], float] = lambda _tick: 1.0,
    ) -> Iterator[Moment]:
        """Ticks until the pipeline has finished.

        `tamper` may change a sample before the pipeline sees it, `stop_when` is the operator, `periods` the
        length of each period.
        """
        plant, counts_per_rad = self.plant, self.config.encoders.counts_per_turn / (2.0 * math.pi)
        command, time_ns, number = Command.SAFE, FIRST_NS, 0
        while not self.pipeline.finished:
            before_ns = time_ns
            time_ns += round(self.config.period_ns * periods(number))
            dt_s = (time_ns - before_ns) * 1e-9
            plant.advance(*command, dt_s)
            sample = Sample(
                number,
                time_ns,
                dt_s,
                math.floor(plant.wheel_angle * counts_per_rad),
                math.floor(plant.road_angle * counts_per_rad),
            )
            phase = self.pipeline.phase
            tick = self.pipeline.step(tamper(sample, phase), Reason.OPERATOR_STOP if stop_when(phase) else Reason.NONE)
            command = Command(tick.drive, tick.brake)
            yield Moment(tick, plant.wheel_speed, plant.road_speed, plant.slip)
            number += 1

    def run(self, **kwargs) -> list[Moment]:
        """All moments of `moments`."""
        return list(self.moments(**kwargs))


@pytest.fixture(scope="session")
def experiment():
    """Maker of experiments from `--set` like settings."""

    def make(*settings: str, pipeline: Callable[[RigConfig], Pipeline] | None = None) -> Experiment:
        config = load_config(settings=settings, checks=[control_check()], follows=preferred_estimator())
        return Experiment(config, None if pipeline is None else pipeline(config))

    return make


@pytest.fixture(scope="session")
def nominal_run(experiment):
    """One run with the default configuration."""
    return experiment().run()


class Rolling:
    """A rig of its own whose wheels roll at a speed, its encoders, and the observer; output first."""

    def __init__(
        self, rig: RigVariation, road_speed: float = 0.0, rate_hz: float = 2000.0, observer: Observer | None = None
    ) -> None:
        per_turn, nominal = rig.wheel_encoder.counts_per_turn, RigParameters.named("mask")
        self.plant = Plant(rig, rig.parameters.r2 / rig.parameters.r1 * road_speed, road_speed)
        self.period_s = 1.0 / rate_hz
        self.observer = observer or Observer(nominal, per_turn, self.period_s)
        self.written = Command.SAFE
        """What the next exchange writes."""
        self.acting: Callable[[Command], Command] = lambda command: command
        """What the rig makes of a command."""
        self._encoders = Encoder(rig, wheel=True), Encoder(rig, wheel=False)
        self._period_ns = round(1e9 / rate_hz)
        self._tick, self._time_ns, self._dt_s = 0, FIRST_NS, self.period_s

    def sample(self, flags: BoardFlags = BoardFlags.NONE) -> Sample:
        plant, (wheel, road) = self.plant, self._encoders
        counts = wheel.read(plant.wheel_angle, plant.wheel_speed), road.read(plant.road_angle, plant.road_speed)
        return Sample(self._tick, self._time_ns, self._dt_s, *counts, flags)

    def move(self, periods: int = 1) -> None:
        """Advance to the next exchange, `periods` later."""
        self.plant.advance(*self.acting(self.written), self.period_s * periods)
        self._tick, self._time_ns = self._tick + 1, self._time_ns + periods * self._period_ns
        self._dt_s = periods * self.period_s

    def tick(self, decide: Command | Callable[[Estimate], Command] = Command.SAFE, periods: int = 1) -> Estimate:
        """Write what was decided before, read, decide; the wheels then turn for `periods`."""
        estimate = self.observer.update(self.sample(), self.written)
        command = decide(estimate) if callable(decide) else decide
        self.move(periods)
        self.written = command
        return estimate


@pytest.fixture(scope="session")
def rolling():
    """Maker of rolling rigs with an observer."""
    return Rolling
