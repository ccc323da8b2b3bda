"""Compiled, the decision path decides the same bits as in Python: step by step, and over whole stops."""

import random

import numpy as np
import pytest
from ensemble_parts import (
    Dividing,
    Failing,
    NotADemand,
    NotANumber,
    Shell,
    ShellOfController,
    Shells,
    Unknown,
    decisions,
)

from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS, ESTIMATORS, Guard, PhaseMachine, control_check, function_of
from inteco_abs.errors import ConfigError
from inteco_abs.machine_code import compiled
from inteco_abs.montecarlo import ConfiguredPolicy, run_stops
from inteco_abs.records import record
from inteco_abs.rig import POPULATIONS, draw
from inteco_abs.signals import BoardFlags, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


def configured(*settings):
    return load_config(settings=settings, checks=[control_check()])


def assert_same_stops(rigs, config, maker=None, python_maker=None, **settings):
    """Compiled and in Python: metrics, errors and every tick of every stop."""
    traced = range(len(rigs))
    stops = run_stops(rigs, config, maker=maker or ConfiguredPolicy(config), traced=traced, **settings)
    python = run_stops(rigs, config, maker=python_maker or Shells(config), traced=traced, **settings)
    assert stops.metrics.tobytes() == python.metrics.tobytes()
    assert (stops.errors, stops.ticks) == (python.errors, python.ticks)
    assert stops.traces.keys() == python.traces.keys()
    for place, trace in stops.traces.items():
        for name, values in trace._asdict().items():
            assert values.tobytes() == getattr(python.traces[place], name).tobytes(), f"rig {place}: {name}"
    return stops


def test_stops_of_every_population_have_the_bits_of_python():
    rigs = [draw(population, seed) for population in POPULATIONS for seed in (7, 31)]
    assert not any(assert_same_stops(rigs, configured()).errors)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (("guard.over_speed_rad_s=200", "encoders.counts_per_turn=1500", "guard.run_up_factor=3.0"), "than the limit"),
        (("experiment.spin_up_timeout_s=0.5",), "start speed was not reached"),
        (("experiment.braking_timeout_s=0.4",), "did not stop in time"),
    ],
)
def test_a_stop_that_the_guard_ends_has_the_bits_of_python(settings, reason):
    stops = assert_same_stops([draw("hard", seed) for seed in range(3)], configured(*settings))
    assert all(reason in error for error in stops.errors)


def test_stops_that_begin_with_braking_have_the_bits_of_python():
    assert_same_stops([draw("rough", 3)], configured("controller.gains.lag_s=0.05"), run_up_from_rad_s=None)


@pytest.mark.long
@pytest.mark.parametrize(
    ("controller", "estimator"), [("reaching-law", "moving-window"), ("predictive-reaching", "observer")]
)
def test_a_stop_that_calls_its_controller_in_python_has_the_bits_of_python(controller, estimator):
    config = configured(f"controller.name={controller}", f"estimator.name={estimator}")
    rigs, made = [draw("hard", 1), draw("rough", 3)], []

    def shells(*rig):
        made.append(rig)
        return ShellOfController(config)(*rig)

    assert not any(assert_same_stops(rigs, config, shells).errors)
    assert len(made) == len(rigs), "no stop was left to Python"


@pytest.mark.long
def test_a_negative_variance_restarts_the_covariance_with_the_bits_of_python():
    config = configured("controller.name=steps", "estimator.name=observer")
    stops = assert_same_stops([draw("wild", 225)], config, ShellOfController(config))
    assert stops.errors == ("",)


@pytest.mark.long
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_every_estimator_with_every_controller_has_the_bits_of_python(estimator):
    """On 1,278 drawn rigs in all. The controller is called: to compile every pair of both would take half an hour."""
    for number, (controller, kind) in enumerate(CONTROLLERS.items()):
        if getattr(kind, "estimator", estimator) == estimator:
            first = 3 * (len(CONTROLLERS) * list(ESTIMATORS).index(estimator) + number)
            rigs = [draw(population, seed) for population in POPULATIONS for seed in range(first, first + 3)]
            config = configured(f"controller.name={controller}", f"estimator.name={estimator}")
            assert_same_stops(rigs, config, ShellOfController(config))


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Failing, "RuntimeError: after 500 ticks (ensemble_parts.py, line "),
        (NotANumber, "not a finite number"),
        (NotADemand, "(ensemble_parts.py, line "),
    ],
)
def test_a_controller_that_fails_in_a_compiled_stop_ends_it_as_in_python(kind, words):
    config = configured()
    made = ShellOfController(config, kind)

    def shells(*rig):
        return map(Shell, made(*rig))

    stops = assert_same_stops([draw("hard", 1)], config, made, shells)
    assert words in stops.errors[0]


def test_a_controller_that_is_interrupted_in_a_compiled_stop_ends_the_run():
    config = configured()

    class Interrupted(Failing):
        def fail(self, _demand):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_stops([draw("hard", 1)], config, maker=ShellOfController(config, Interrupted))


@pytest.mark.long
@pytest.mark.parametrize(
    ("controller", "estimator"),
    [
        *((controller, "moving-window") for controller in CONTROLLERS if controller != "predictive-reaching"),
        *(("reaching-law", estimator) for estimator in ESTIMATORS),
        ("predictive-reaching", "observer"),
        ("predictive-reaching", "adaptive-observer"),
    ],
)
def test_stops_of_every_part_have_the_bits_of_python(controller, estimator):
    rigs = [draw(population, seed) for population in POPULATIONS for seed in range(5)]
    assert_same_stops(rigs, configured(f"controller.name={controller}", f"estimator.name={estimator}"))


def test_a_number_that_is_not_finite_is_left_to_python_which_may_raise():
    config = configured()

    def dividing(variation, state):
        estimator, _ = ConfiguredPolicy(config)(variation, state)
        return estimator, Dividing()

    stops = run_stops([draw("hard", 1)], config, maker=dividing)
    assert function_of(Dividing()) is not None
    assert "division by zero" in stops.errors[0]


MOVING = (Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED)


def test_a_function_that_cannot_be_compiled_is_an_error_of_the_configuration():
    config = configured()

    def unknown(variation, state):
        estimator, _ = ConfiguredPolicy(config)(variation, state)
        return estimator, Unknown()

    with pytest.raises(ConfigError, match=r"a function that cannot be compiled: .*no_such_name"):
        run_stops([draw("hard", 1)], config, maker=unknown)


class Wheels:
    """Wheels that do in each phase what they should, but for accidents; reproducible."""

    def __init__(self, seed, rate_hz, accidents):
        self._random, self._period_ns, self._accidents = random.Random(seed), round(1e9 / rate_hz), accidents
        self._time_ns, self._wheel, self._road, self._speed, self._tick = 5_000_000_000, 0.0, 0.0, 0.0, -1

    def sample(self, phase):
        """Numbers of the next sample, and the reason of a request to stop."""
        draws, self._tick = self._random, self._tick + 1
        accident = draws.random() < self._accidents * (phase in MOVING)
        step_ns = self._period_ns * (draws.choice((1, 2, 5)) if accident else 1) + draws.randrange(-1000, 1000)
        step_s = step_ns * 1e-9
        rate = 30.0 if phase == Phase.SPIN_UP else -120.0
        self._speed = max(0.0, self._speed + rate * step_s)
        self._time_ns += step_ns
        self._road += self._speed * step_s * 326.0
        self._wheel += self._speed * step_s * 326.0 * (0.8 if phase == Phase.BRAKING else 1.0)
        if accident and draws.random() < 0.3:
            self._road += draws.choice((-40.0, 3.0, 5000.0))
        flags = draws.choice((0, 0, BoardFlags.STALE, BoardFlags.SLOW)) if accident else 0
        stop = Reason.OPERATOR_STOP if draws.random() < self._accidents * 0.01 else Reason.NONE
        return self._tick, self._time_ns, step_s, int(self._wheel), int(self._road), int(flags), int(stop)


def path(config):
    """Constants and state of machine and guard."""
    return PhaseMachine(config, Dividing()), Guard(config)


@pytest.mark.parametrize("rate_hz", [50, 2000])
@pytest.mark.parametrize("accidents", [0.0, 0.001, 0.02])
@pytest.mark.parametrize("seed", range(4))
def test_machine_and_guard_step_through_anything_with_the_bits_of_python(seed, accidents, rate_hz):
    config = configured(
        f"loop.rate_hz={rate_hz}", "experiment.stops=2", "experiment.start_speed_rad_s=25", "experiment.idle_s=0.1",
        "experiment.hold_s=0.1", "experiment.braking_timeout_s=0.5", "guard.run_up_factor=2.0",
        "estimator.window_s=0.05",
    )  # fmt: skip
    machine, guard = path(config)
    wheels, brakes = Wheels(seed, rate_hz, accidents), random.Random(seed)
    given, python = [], []
    for _ in range(3 * rate_hz):
        brake = brakes.choice((0.0, 0.5, 1.0, 1.2, float("nan") if brakes.random() < accidents else 0.7))
        given.append((*wheels.sample(machine.phase), brake))
        python.append(decisions(machine.k, machine, guard.k, guard, given[-1]))
    assert accidents or machine.phase == Phase.DONE, "both stops"
    records = [record(part) for each in path(config) for part in (each.k, each)]
    found = np.empty((len(given), len(python[0])))
    compiled(all_decisions)(*records, np.array(given), found)
    assert found.tobytes() == np.array(python, float).tobytes()
    for mine, own in zip(records[1::2], (machine, guard), strict=True):
        assert list(leaves(mine)) == list(leaves(record(own)))


def leaves(part, name=""):
    """Names and bytes of a record's numbers, without what lies between them."""
    if part.dtype.names is None:
        yield name, part.tobytes()
    for each in part.dtype.names or ():
        yield from leaves(part[each], f"{name}.{each}")


def all_decisions(machine_k, machine, guard_k, guard, given, found):
    for i in range(len(given)):
        row = given[i]
        numbers = (int(row[0]), int(row[1]), row[2], int(row[3]), int(row[4]), int(row[5]), int(row[6]), row[7])
        found[i] = decisions(machine_k, machine, guard_k, guard, numbers)
