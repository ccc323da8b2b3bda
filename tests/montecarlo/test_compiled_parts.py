"""Estimators and controllers as machine code: bit for bit what CPython makes of them."""

from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.config import load_config
from inteco_abs.control import (
    CONTROLLERS,
    ESTIMATORS,
    Pipeline,
    control_check,
    function_of,
    make_controller,
    make_estimator,
    preferred_estimator,
)
from inteco_abs.machine_code import compiled
from inteco_abs.records import record
from inteco_abs.rig import Encoder, Plant, draw
from inteco_abs.signals import Command, Estimate, Phase, Prediction, Sample

SEEDS = st.integers(0, 2**32 - 1)
PERIOD_NS = 500_000
few = settings(max_examples=5, deadline=None)


def some_by_default(names, default):
    """The others take too long to compile."""
    return [pytest.param(name, marks=() if name in default else pytest.mark.long) for name in names]


estimators = pytest.mark.parametrize("name", some_by_default(ESTIMATORS, {"kalman"}))
controllers = pytest.mark.parametrize("name", some_by_default(CONTROLLERS, {"smith-relay"}))


def configured(*settings):
    return load_config(settings=settings, checks=[control_check()], follows=preferred_estimator())


class Watched:
    """The observer, and all that goes through it."""

    def __init__(self, config):
        self._observer = make_estimator(config)
        self.seen = []

    def update(self, sample, sent):
        self.seen.append((sample, sent))
        return self._observer.update(sample, sent)


@cache
def recorded(population, seed):
    """Samples of a stop, of which some come late, and what was sent with them."""
    config = configured("controller.name=predictive-reaching")
    rig, watched = draw(population, seed), Watched(config)
    pipeline = Pipeline(config, watched, make_controller(config), Phase.SPIN_UP)
    plant = Plant(rig, rig.parameters.r2 / rig.parameters.r1 * 178.0, 178.0)
    wheel, road = Encoder(rig, wheel=True), Encoder(rig, wheel=False)
    time_ns, periods = 0, 1
    while plant.road_speed > 1.0:
        counts, tick = (
            (wheel.read(plant.wheel_angle, plant.wheel_speed), road.read(plant.road_angle, plant.road_speed)),
            len(watched.seen),
        )
        pipeline.step(Sample(tick, time_ns, periods * PERIOD_NS * 1e-9, *counts))
        periods = 3 if tick % 97 == 96 else 1
        plant.advance(*pipeline.command, periods * PERIOD_NS * 1e-9)
        time_ns += periods * PERIOD_NS
    assert pipeline.error is None
    return watched.seen


def random_samples(seed):
    """Wheels that jerk, clocks that stand still, gaps, jumps of the count, and duties that change."""
    random = np.random.default_rng(seed)
    ticks = 400
    times = np.cumsum(
        random.choice([0, 499_000, PERIOD_NS, 2 * PERIOD_NS, 10**9], ticks, p=[0.01, 0.1, 0.83, 0.05, 0.01])
    )
    speeds = np.clip(np.cumsum(random.normal(0.0, 3.0, (ticks, 2)), axis=0) + random.uniform(0.0, 200.0), -5.0, 250.0)
    counts = np.cumsum(speeds * 2048 / 6.28 * 5e-4 + (random.random((ticks, 2)) < 0.002) * 900.0, axis=0).astype(int)
    drives, brakes = random.choice([0.0, 0.0, 0.0, 0.0, 1.0], ticks // 20), random.random(ticks // 5)
    for i, (time_ns, (wheel, road)) in enumerate(zip(times.tolist(), counts.tolist(), strict=True)):
        yield Sample(i, time_ns, 0.0005, wheel, road), Command(float(drives[i // 20]), float(brakes[i // 5]))


def random_estimates(seed):
    """Of each the numbers, a prediction, and whether it has that."""
    random = np.random.default_rng(seed)
    high = [50.0, 190.0, 190.0, 9.0, 1.0, 1.2, 0.05, 0.05, 0.03, 0.09]
    for _ in range(400):
        wheel, road, slip = (random.random(3) * [200.0, 200.0, 1.0]).tolist()
        seen = Prediction(*random.uniform(0.02, high).tolist())
        yield Estimate(wheel, road, slip, bool(random.random() < 0.95), seen), bool(random.random() < 0.9)


def controlled(k, s, estimate, predicted, control):
    """Demand for an estimate that has its prediction or not: one type for both, as in a stop."""
    wheel, road, slip, valid, seen = estimate
    return control(k, s, Estimate(wheel, road, slip, valid, seen if predicted else None), 0.0005)


def bits(value):
    """Of every number in a result."""
    if value is None:
        return None
    return [bits(each) for each in value] if isinstance(value, tuple) else float(value).hex()


def records(part):
    return record(part.k), record(part)


def assert_estimates_same(name, inputs):
    """Outputs, number by number, and the state in which it ends."""
    estimator = make_estimator(configured(f"estimator.name={name}"))
    (k, s), estimate = records(estimator), compiled(function_of(estimator))
    for sample, sent in inputs:
        assert bits(estimate(k, s, sample, sent)) == bits(estimator.update(sample, sent))
    np.testing.assert_equal(s.tolist(), record(estimator).tolist())


@estimators
@pytest.mark.parametrize("rig", [("hard", 2), ("rough", 2)])
def test_an_estimator_makes_the_same_of_a_recorded_stop(name, rig):
    assert_estimates_same(name, recorded(*rig))


@estimators
@few
@given(SEEDS)
def test_an_estimator_makes_the_same_of_any_samples(name, seed):
    assert_estimates_same(name, random_samples(seed))


@controllers
@few
@given(SEEDS)
def test_a_controller_makes_the_same_of_any_estimates(name, seed):
    controller = make_controller(configured(f"controller.name={name}"))
    (k, s), control = records(controller), function_of(controller)
    native = compiled(partial(controlled, control=control))
    for estimate, predicted in random_estimates(seed):
        own = controlled(controller.k, controller, estimate, predicted, control)
        assert bits(native(k, s, estimate, predicted)) == bits(own)
    np.testing.assert_equal(s.tolist(), record(controller).tolist())
