"""`experiment.stops`: one stop after the other, each from rest, with the physics of the rig around them."""

from dataclasses import replace
from itertools import groupby

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS, Gain, PhaseMachine, build_pipeline
from inteco_abs.errors import ConfigError
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

QUICK = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")
ONE_STOP = [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED]


class Counting:
    """Brakes the harder the more often it was asked; its own state is what a stop must not leave to the next."""

    gains = (Gain("first", 0.4, 0.0, 1.0, "", "brake at the first update"),)
    internals = ("updates", "made")
    made = 0

    def __init__(self, _setup, first) -> None:
        Counting.made += 1
        self._first = first
        self._history = [first]

    def update(self, _estimate, _dt_s):
        self._history.append(min(0.9, self._history[-1] + 1e-4))
        return BrakeDemand(self._history[-1], 0.0, 0.0, (len(self._history) - 1.0, float(Counting.made), 0.0, 0.0))


def stops_of(moments):
    """Ticks by phase, from one idle phase to the next."""
    runs = [(phase, [moment.tick for moment in run]) for phase, run in groupby(moments, lambda m: m.tick.phase)]
    starts = [i for i, (phase, _) in enumerate(runs) if phase is Phase.IDLE]
    return [dict(runs[first:end]) for first, end in zip(starts, [*starts[1:], len(runs)], strict=True)]


@pytest.fixture(scope="module")
def played(experiment):
    """Ticks of a run with several stops, with the controller that counts."""

    def run(stops, *settings):
        rig = experiment(*QUICK, f"experiment.stops={stops}", *settings, pipeline=counting)
        return rig.run()

    def counting(config):
        controller = replace(config.controller, name="counting")
        return build_pipeline(replace(config, controller=controller), {"counting": Counting})

    return run


@pytest.fixture(scope="module")
def three(played):
    return played(3)


@pytest.mark.parametrize("stops", [1, 2, 3, pytest.param(7, marks=pytest.mark.long)])
def test_the_phases_come_in_order_as_often_as_there_are_stops(played, stops):
    moments = played(stops)
    phases = [phase for phase, _ in groupby(moment.tick.phase for moment in moments)]
    assert phases == [*ONE_STOP * stops, Phase.DONE]


def test_nothing_trips_in_between(three):
    assert {moment.tick.reason for moment in three} == {Reason.NONE}


def test_every_stop_begins_from_rest_with_the_outputs_off(three):
    for stop in stops_of(three):
        for phase in (Phase.IDLE, Phase.ARMED):
            assert {(tick.drive, tick.brake) for tick in stop[phase]} == {Command.SAFE}
            counts = [(tick.wheel_count, tick.road_count) for tick in stop[phase]]
            assert max(abs(a - b) for one in counts for a, b in zip(one, counts[0], strict=True)) <= 4


def test_idle_and_armed_last_as_long_before_every_stop(three):
    for stop in stops_of(three):
        for phase in (Phase.IDLE, Phase.ARMED):
            assert len(stop[phase]) == pytest.approx(40, abs=2)


def test_every_stop_reaches_the_start_speed_again_and_brakes_to_rest(three):
    stops = stops_of(three)
    assert len(stops) == 3
    for stop in stops:
        assert stop[Phase.BRAKING][0].road_speed_rad_s == pytest.approx(20.0, abs=1.5)
        assert abs(stop[Phase.STOPPED][-1].road_speed_rad_s) < 0.5


def test_the_controller_is_fresh_at_every_stop_and_made_only_once(three):
    firsts = [next(tick for tick in stop[Phase.BRAKING] if tick.c0) for stop in stops_of(three)]
    assert [tick.c0 for tick in firsts] == [1.0] * 3
    assert [tick.brake_request for tick in firsts] == [pytest.approx(0.4001)] * 3
    assert len({tick.c1 for tick in firsts}) == 1
    lasts = [stop[Phase.BRAKING][-1].c0 for stop in stops_of(three)]
    assert min(lasts) > 100.0


def test_every_update_of_a_stop_is_counted_from_one(three):
    for stop in stops_of(three):
        counts = [tick.c0 for tick in stop[Phase.BRAKING][1:]]
        assert counts == [float(number) for number in range(1, len(counts) + 1)]


def test_no_demand_of_one_stop_is_held_into_the_next(three):
    for stop in stops_of(three)[1:]:
        before = [tick for phase in (Phase.IDLE, Phase.ARMED, Phase.SPIN_UP) for tick in stop[phase]]
        assert {tick.brake_request for tick in before} == {0.0}
        assert {tick.c0 for tick in before} == {0.0}


def test_the_brake_is_held_after_every_stop_as_long_as_configured(three):
    for stop in stops_of(three):
        assert len(stop[Phase.STOPPED]) == pytest.approx(100, abs=2)
        assert {tick.brake for tick in stop[Phase.STOPPED]} == {stop[Phase.STOPPED][0].brake}


def test_stops_without_a_hold_follow_one_another_too(played):
    moments = played(3, "experiment.hold_s=0.0")
    assert {moment.tick.reason for moment in moments} == {Reason.NONE}
    assert len(stops_of(moments)) == 3


@pytest.mark.long
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_every_shipped_controller_makes_the_same_stop_again(experiment, controller):
    moments = experiment(*QUICK, "experiment.stops=2", f"controller.name={controller}").run()
    first, second = stops_of(moments)
    assert {moment.tick.reason for moment in moments} == {Reason.NONE}
    assert len(second[Phase.BRAKING]) == pytest.approx(len(first[Phase.BRAKING]), rel=0.05)


def test_a_stop_that_fails_is_the_last(experiment):
    moments = experiment(*QUICK, "experiment.stops=5", "experiment.braking_timeout_s=0.1").run()
    assert moments[-1].tick.phase is Phase.FAULT
    assert moments[-1].tick.reason is Reason.BRAKING_TIMEOUT
    assert len(stops_of(moments)) == 1


@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.SPIN_UP, Phase.BRAKING])
def test_an_operator_can_end_it_in_the_second_stop(experiment, phase):
    seen = []

    def second_time(now):
        seen.append(now)
        return [each for each, _ in groupby(seen)].count(phase) == 2

    moments = experiment(*QUICK, "experiment.stops=4").run(stop_when=second_time)
    assert moments[-1].tick.reason is Reason.OPERATOR_STOP
    assert len(stops_of(moments)) == 2


class Uncopyable:
    gains = ()
    internals = ()

    def __init__(self, _setup) -> None:
        self._lines = iter(lambda: 1, 2)
        self._frames = (number for number in range(3))

    def update(self, _estimate, _dt_s):
        return BrakeDemand(0.5)


def made_with(stops):
    config = load_config(settings=[f"experiment.stops={stops}"])
    controller = replace(config.controller, name="mine")
    return build_pipeline(replace(config, controller=controller), {"mine": Uncopyable})


def test_a_controller_that_cannot_be_copied_is_refused_before_anything_begins():
    with pytest.raises(ConfigError, match="mine cannot be made"):
        made_with(2)


def test_a_controller_that_cannot_be_copied_can_do_one_stop():
    assert made_with(1)


class Unsteady:
    """Two stops with scripted wheels, and a computer that is once late for a long time."""

    def __init__(self, encoders) -> None:
        settings = ("experiment.start_speed_rad_s=10.0", "experiment.idle_s=1.0", "experiment.hold_s=0.0")
        self.sequence = PhaseMachine(load_config(settings=[*settings, "experiment.stops=2"]), Even())
        self.encoders = encoders()

    def step(self, speed, **timing):
        self.sequence.advance(self.encoders.turn(speed, speed, **timing), NO_ESTIMATE)

    def until(self, phase, speed):
        for _ in range(10_000):
            if self.sequence.phase is phase:
                return
            self.step(speed)
        raise AssertionError(f"{phase.name} never came")

    def second(self, phase):
        """From the beginning of the first stop to that phase of the second."""
        self.until(Phase.SPIN_UP, 0.0)
        self.until(Phase.BRAKING, 12.0)
        for _ in range(1000):
            self.step(200.0)  # enough to lift any mean that reaches back so far
        self.until(Phase.STOPPED, 0.0)
        self.until(Phase.SPIN_UP, 0.0)
        if phase is Phase.BRAKING:
            self.until(Phase.BRAKING, 12.0)


class Even:
    def update(self, _estimate, _dt_s):
        return BrakeDemand(0.5)


NO_ESTIMATE = Estimate(0.0, 0.0, 0.0, valid=False)


@pytest.mark.parametrize(("phase", "speed"), [(Phase.SPIN_UP, 0.0), (Phase.BRAKING, 12.0)])
def test_a_late_tick_does_not_let_the_stop_before_decide_on_this_one(encoders, phase, speed):
    play = Unsteady(encoders)
    play.second(phase)
    play.step(speed)
    play.step(speed)
    play.step(speed, periods=105.0)
    assert play.sequence.phase is phase
