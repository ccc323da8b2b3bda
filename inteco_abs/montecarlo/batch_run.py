"""Stops of some rigs together: one batch of plants, and a pipeline for each rig, stepped as the loop steps it."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import Pipeline, config_of_stop, function_of, swing_band
from inteco_abs.errors import ConfigError, describe_error
from inteco_abs.machine_code import compile_problem, compiled
from inteco_abs.montecarlo.batch import BatchPlant
from inteco_abs.montecarlo.closed_loop import COLUMNS, function_of_stop, parts_of
from inteco_abs.montecarlo.policies import PolicyFactory, TrueState
from inteco_abs.montecarlo.python_controller import PythonController
from inteco_abs.montecarlo.results import METRICS, METRICS_ROW, StopResults, Trace
from inteco_abs.rig import LONGEST_BRAKING_S, RigVariation, nominal_parameters
from inteco_abs.sessions import STANDSTILL_RAD_S, Array, SlipErrors, StopTrace, stop_metrics
from inteco_abs.signals import EXPLANATIONS, Phase, Reason, Sample

_FIRST_ROWS: Final = 4096


@dataclass(frozen=True, slots=True)
class Experiment:
    """One stop of each of `rigs`, with the estimator and controller that `maker` makes for it.

    The wheels roll at `run_up_from_rad_s` at first and are driven to the configured start speed; None: they roll at
    the start speed, and braking begins at once. Each rig has a guard, of a lab that knows its amplifier: its brake
    limit is at most what that lets through. `traced` are the places of rigs whose course is to be kept.
    Raises ValueError for a run-up that cannot be.
    """

    rigs: tuple[RigVariation, ...]
    config: RigConfig
    maker: PolicyFactory
    run_up_from_rad_s: float | None = 165.0
    traced: Collection[int] = ()

    def __post_init__(self) -> None:
        start = self.config.experiment.start_speed_rad_s
        if self.run_up_from_rad_s is not None and not 0.0 <= self.run_up_from_rad_s < start:
            raise ValueError(
                f"run_up_from_rad_s = {self.run_up_from_rad_s!r}: must be at least 0 and below "
                f"experiment.start_speed_rad_s = {start!r}; None for a stop without run-up"
            )


class _Ended(NamedTuple):
    """One stop, over."""

    decisions: int
    error: str
    rows: Array | None
    """COLUMNS, for each tick from the first of braking on; None if it never braked."""


def run_shard(experiment: Experiment) -> StopResults:
    """All stops of one experiment, in this thread. Raises ConfigError if a rig's parts cannot be made.

    They run compiled where the estimator is a function, with the same bits as in Python.
    """
    config, rigs = experiment.config, experiment.rigs
    ended = dict(_compiled_stops(experiment))
    left = [i for i in range(len(rigs)) if i not in ended]
    if left:
        ended |= zip(left, _Shard(replace(experiment, rigs=tuple(rigs[i] for i in left))).run(), strict=True)
    stops = [ended[i] for i in range(len(rigs))]
    traces = {i: _trace(rows, config) for i in sorted(experiment.traced) if (rows := stops[i].rows) is not None}
    metrics = [_metrics(stop, config) for stop in stops]
    errors = tuple(stop.error for stop in stops)
    return StopResults(np.array(metrics, METRICS_ROW), errors, sum(stop.decisions for stop in stops), traces)


def _compiled_stops(experiment: Experiment) -> Iterator[tuple[int, _Ended]]:
    """Place and stop of each rig whose estimator is a function; a controller that is none is called at each demand.

    A stop in which a number is not finite, or the controller raises, is left out: Python repeats it with the error.
    """
    config, rigs = experiment.config, experiment.rigs
    speed, phase = _start(experiment)
    batch, longest = BatchPlant(rigs, speed), _longest(config)
    rows = np.empty((longest + 1, COLUMNS))
    for i, rig in enumerate(rigs):
        estimator, controller = experiment.maker(rig, TrueState(batch, i, rig))
        called = None if function_of(controller) else PythonController(controller)
        function = function_of_stop(estimator, called or controller)
        if function is None:
            return
        parts = parts_of(config_of_stop(config, rig), estimator, called or controller, phase)
        arguments = batch.rig(i), parts, (config.period_ns, longest, config.controller.reference_slip), rows
        if i == 0 and (problem := compile_problem(function, arguments)):
            names = f"{config.controller.name} on {config.estimator.name}"
            problem = f"{names} has a function that cannot be compiled: {problem}; a class without `function` can run"
            raise ConfigError.of("controller.name", problem)
        try:
            course = compiled(function)(*arguments)
        except ValueError:
            continue
        if called is not None and isinstance(called.error, KeyboardInterrupt):
            raise called.error
        if course.finite:
            error = EXPLANATIONS[Reason(course.reason)] if course.reason else ""
            braked = rows[: course.ended + 1 - course.began].copy() if course.began >= 0 else None
            yield i, _Ended(course.decisions, error, braked)


def _start(experiment: Experiment) -> tuple[float, Phase]:
    """Road speed in rad/s and phase in which the stops begin."""
    rolling_from = experiment.run_up_from_rad_s
    if rolling_from is None:
        return experiment.config.experiment.start_speed_rad_s, Phase.BRAKING
    return rolling_from, Phase.SPIN_UP


def _longest(config: RigConfig) -> int:
    return round(LONGEST_BRAKING_S * 1e9 / config.period_ns)


class _Stop:
    """One rig's pipeline, and where its stop stands."""

    __slots__ = ("began", "ended", "error", "pipeline", "ticks")

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self.began = -1
        """Tick at which braking began, or -1."""
        self.ended = -1
        """Last tick of the stop, or -1."""
        self.error = ""
        self.ticks = 0

    def step(self, sample: Sample) -> float:
        """Decide on one sample; the slip as estimated."""
        self.ticks += 1
        pipeline = self.pipeline
        estimate = pipeline.decide(sample)
        if pipeline.reason is not Reason.NONE:
            self.ended = sample.tick
            failure = pipeline.error
            self.error = EXPLANATIONS[pipeline.reason] if failure is None else describe_error(failure)
        elif self.began < 0 and pipeline.phase is Phase.BRAKING:
            self.began = sample.tick
        return estimate.slip


class _Shard:
    """The batch, its stops, and what is recorded of them."""

    def __init__(self, experiment: Experiment) -> None:
        config, rigs = experiment.config, experiment.rigs
        speed, phase = _start(experiment)
        self._batch = BatchPlant(rigs, speed)
        self._stops = [
            _Stop(Pipeline(config_of_stop(config, rig), *experiment.maker(rig, TrueState(self._batch, i, rig)), phase))
            for i, rig in enumerate(rigs)
        ]
        self._period_ns = config.period_ns
        self._longest = _longest(config)
        self._first_row = -1  # tick of the first row
        self._rows = np.empty((_FIRST_ROWS, COLUMNS, len(rigs)))
        self._drives, self._brakes, self._slips, self._references, self._errors = np.zeros((5, len(rigs)))

    def run(self) -> Iterator[_Ended]:
        """All ticks, until every stop has ended."""
        running = list(enumerate(self._stops))
        tick, period_s = 0, self._period_ns / 1e9
        while running:
            self._tick(running, tick, period_s)
            if self._first_row >= 0:
                self._record(tick)
            running = [one for one in running if one[1].ended < 0]
            self._batch.advance(self._drives, self._brakes, period_s)
            tick += 1
        return map(self._ended, range(len(self._stops)))

    def _tick(self, running: list[tuple[int, _Stop]], tick: int, period_s: float) -> None:
        """Read, decide; what was decided takes the rig's own delay from here, as in a loop that writes before it reads.

        A stop that has ended keeps its brake, one that has failed does not.
        """
        time_ns, longest = tick * self._period_ns, self._longest
        wheel_counts, road_counts = (counts.tolist() for counts in self._batch.read_encoders())
        road_speeds = self._batch.road_speed.tolist()
        drives, brakes, slips = self._drives, self._brakes, self._slips
        for i, stop in running:
            began = stop.began
            if began >= 0 and (road_speeds[i] < STANDSTILL_RAD_S or tick - began >= longest):
                stop.ended = tick
                continue
            slips[i] = stop.step(Sample(tick, time_ns, period_s, wheel_counts[i], road_counts[i]))
            drives[i], brakes[i] = stop.pipeline.command
            self._references[i], self._errors[i] = stop.pipeline.reference_slip, stop.pipeline.machine.demand.switching
            if stop.began == tick and self._first_row < 0:
                self._first_row = tick

    def _record(self, tick: int) -> None:
        """Keep the state at this tick; all rigs', as that is one copy each."""
        place, batch = tick - self._first_row, self._batch
        if place == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        row = self._rows[place]
        row[0], row[1], row[2] = batch.wheel_speed, batch.road_speed, batch.slip
        row[3], row[4] = batch.brake_torque, batch.road_angle
        row[5], row[6], row[7], row[8] = self._slips, self._brakes, self._references, self._errors

    def _ended(self, i: int) -> _Ended:
        stop, first = self._stops[i], self._first_row
        braked = slice(stop.began - first, stop.ended + 1 - first)
        return _Ended(stop.ticks, stop.error, self._rows[braked, :, i] if stop.began >= 0 else None)


def _metrics(stop: _Ended, config: RigConfig) -> tuple[float, ...]:
    """NaN for what the stop does not have; a stop that failed has nothing."""
    if stop.error or stop.rows is None:
        return (math.nan,) * len(METRICS)
    trace = _trace(stop.rows, config)
    course = StopTrace(
        _since_ns(stop.rows, config),
        trace.slip,
        trace.slip_estimated,
        trace.road_speed_rad_s,
        trace.road_angle_rad,
        trace.brake,
    )
    parameters = nominal_parameters(config.model)
    reference, error = stop.rows[:, 7].copy(), stop.rows[:, 8].copy()
    band = swing_band(config)
    errors = SlipErrors(band, error, reference, np.full(len(error), config.period_ns / 1e9)) if band > 0.0 else None
    found = stop_metrics(course, reference, parameters, errors)
    values = (found[name.removesuffix("_true")] for name in METRICS)
    return tuple(math.nan if value is None else value for value in values)


def _since_ns(rows: Array, config: RigConfig) -> Array:
    return np.arange(len(rows), dtype=np.int64) * config.period_ns


def _trace(rows: Array, config: RigConfig) -> Trace:
    time_s = _since_ns(rows, config) * 1e-9
    wheel_speed, road_speed, slip, torque, angle, estimated, brake, _, _ = rows.T.copy()
    return Trace(time_s, wheel_speed, road_speed, slip, estimated, torque, angle - angle[0], brake)
