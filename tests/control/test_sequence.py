import math
from itertools import groupby, pairwise
from typing import NamedTuple

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import PhaseMachine
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Reason

SETTINGS = (
    "experiment.idle_s=0.05",
    "experiment.start_speed_rad_s=120.0",
    "experiment.hold_s=0.1",
    "experiment.drive_duty=0.8",
    "experiment.spin_up_timeout_s=1.0",
    "experiment.braking_timeout_s=0.5",
)
BLIND = Estimate(math.nan, math.nan, 0.0, valid=False)
RATE_RAD_S2 = 400.0


class Request(NamedTuple):
    """What the sequence requests, the demand behind it, and a reason to stop or NONE."""

    command: Command
    demand: BrakeDemand
    reason: Reason


class Counting:
    """Controller that demands a different brake each time, and remembers what it was given."""

    def __init__(self) -> None:
        self.seen: list[tuple[Estimate, float]] = []

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        self.seen.append((estimate, dt_s))
        return BrakeDemand(0.5 + 1e-4 * len(self.seen), 4.0, 0.1, (1.0, 2.0, 3.0, 4.0))


class Play:
    """A sequence with scripted wheels; `steps` is (phase after the step, request) of every sample."""

    def __init__(self, encoders, *settings: str) -> None:
        self.controller = Counting()
        self.sequence = PhaseMachine(load_config(settings=[*SETTINGS, *settings]), self.controller)
        self.encoders = encoders()
        self.period_s = self.encoders.period_s
        self.steps = []

    @property
    def phase(self) -> Phase:
        return self.sequence.phase

    def step(self, road_speed: float = 0.0, wheel_speed: float | None = None, **timing):
        sample = self.encoders.turn(road_speed if wheel_speed is None else wheel_speed, road_speed, **timing)
        machine = self.sequence
        machine.advance(sample, BLIND)
        request = Request(Command(machine.drive_request, machine.brake_request), machine.demand, machine.reason)
        self.steps.append((self.phase, request))
        return request

    def rest(self, duration_s: float) -> None:
        for _ in range(round(duration_s / self.period_s)):
            self.step()

    def reach(self, phase: Phase) -> None:
        """Play the nominal script until `phase` is entered."""
        speed = 0.0
        while self.phase is not phase:
            if self.phase is Phase.SPIN_UP:
                speed += RATE_RAD_S2 * self.period_s
            elif self.phase is Phase.BRAKING:
                speed = max(0.0, speed - RATE_RAD_S2 * self.period_s)
            assert self.step(speed).reason is Reason.NONE
            assert len(self.steps) < 20_000

    def requests(self, phase: Phase):
        return [request for at, request in self.steps if at is phase]


@pytest.fixture
def play(encoders):
    return Play(encoders)


@pytest.fixture
def nominal(play):
    play.reach(Phase.DONE)
    play.rest(0.05)
    return play


def test_the_phases_come_in_order_and_each_once(nominal):
    assert [phase for phase, _ in groupby(nominal.steps, key=lambda step: step[0])] == [
        Phase.IDLE,
        Phase.ARMED,
        Phase.SPIN_UP,
        Phase.BRAKING,
        Phase.STOPPED,
        Phase.DONE,
    ]


def test_idle_and_armed_last_as_long_as_configured_with_the_outputs_off(nominal):
    for phase in (Phase.IDLE, Phase.ARMED):
        requests = nominal.requests(phase)
        assert len(requests) * nominal.period_s == pytest.approx(0.05, abs=nominal.period_s)
        assert {request.command for request in requests} == {Command.SAFE}


def test_the_drive_is_on_throughout_the_spin_up_except_at_its_first_tick(nominal):
    first, *others = nominal.requests(Phase.SPIN_UP)
    assert first.command == Command.SAFE
    assert {request.command for request in others} == {Command(0.8, 0.0)}


def test_the_first_tick_of_braking_has_both_outputs_off(nominal):
    assert nominal.requests(Phase.BRAKING)[0].command == Command.SAFE


def test_drive_is_on_in_spin_up_only_and_brake_in_braking_and_stopped(nominal):
    for phase, request in nominal.steps:
        assert request.command.drive == 0.0 or phase is Phase.SPIN_UP
        assert request.command.brake == 0.0 or phase in (Phase.BRAKING, Phase.STOPPED)


def test_the_brake_never_follows_the_drive_without_a_tick_of_rest(nominal):
    commands = [request.command for _, request in nominal.steps]
    assert any(command.drive for command in commands)
    assert any(command.brake for command in commands)
    for before, after in pairwise(commands):
        assert not (after.brake and (before.drive or after.drive))


def test_while_braking_every_demand_of_the_controller_is_passed_on(nominal):
    demands = [request.demand for request in nominal.requests(Phase.BRAKING)[1:]]
    assert [demand.brake for demand in demands] == [0.5 + 1e-4 * k for k in range(1, len(demands) + 1)]
    assert [request.command.brake for request in nominal.requests(Phase.BRAKING)[1:]] == [d.brake for d in demands]


def test_controller_runs_only_while_braking_with_estimate_and_time_step(nominal):
    # asked from the second tick of braking to the first of standstill
    assert len(nominal.controller.seen) == len(nominal.requests(Phase.BRAKING))
    assert {dt_s for _, dt_s in nominal.controller.seen} == {nominal.period_s}
    assert all(estimate is BLIND for estimate, _ in nominal.controller.seen)


def test_the_controller_gets_the_time_that_has_passed(play):
    play.reach(Phase.BRAKING)
    play.step(120.0, periods=3.0)
    assert play.controller.seen[-1][1] == pytest.approx(3.0 * play.period_s)


def test_the_last_demand_is_held_for_the_hold_time_after_the_stop(nominal):
    stopped = nominal.requests(Phase.STOPPED)
    assert len(stopped) * nominal.period_s == pytest.approx(0.1, abs=nominal.period_s)
    assert {request.demand for request in stopped} == {stopped[0].demand}
    assert {request.command for request in stopped} == {Command(0.0, stopped[0].demand.brake)}
    assert stopped[0].demand.brake > 0.5


def test_after_done_the_outputs_stay_off_even_if_the_wheels_move_again(nominal):
    for _ in range(100):
        assert nominal.step(50.0).command == Command.SAFE
    assert nominal.phase is Phase.DONE


def test_braking_begins_when_the_mean_speed_over_20_ms_reaches_the_start_speed(play):
    play.reach(Phase.SPIN_UP)
    for _ in range(100):
        play.step(119.0)
    assert play.phase is Phase.SPIN_UP
    steps = 0
    while play.phase is Phase.SPIN_UP:
        play.step(121.0)
        steps += 1
    # mean of 119 and 121 is 120 when half of the window is new; one count is 0.15 rad/s
    assert steps * play.period_s == pytest.approx(0.010, abs=0.002)


def test_a_single_wrong_count_does_not_start_the_braking(play):
    play.reach(Phase.SPIN_UP)
    for _ in range(100):
        play.step(60.0)
    play.step(60.0 + 1000.0)
    for _ in range(100):
        play.step(60.0)
    assert play.phase is Phase.SPIN_UP


@pytest.mark.parametrize("after", [0, 1, 5, 30])
def test_wrong_count_at_the_start_of_spin_up_does_not_start_braking(play, after):
    play.reach(Phase.SPIN_UP)
    for _ in range(after):
        play.step(0.0)
    play.step(450.0)  # less than the guard calls impossible
    for _ in range(20):
        play.step(0.0)
    assert play.phase is Phase.SPIN_UP


def test_the_start_does_not_depend_on_the_wheel_or_the_estimator(play):
    play.reach(Phase.SPIN_UP)
    for _ in range(45):
        play.step(121.0, wheel_speed=0.0)
    assert play.phase is Phase.BRAKING


def brake_from_start(play) -> None:
    play.reach(Phase.BRAKING)
    for _ in range(100):
        play.step(100.0)


def test_a_road_that_creeps_above_the_stop_speed_has_not_stopped(play):
    brake_from_start(play)
    for _ in range(400):
        play.step(0.65)
    assert play.phase is Phase.BRAKING


def test_a_road_that_creeps_below_the_stop_speed_has_stopped_within_the_window(play):
    brake_from_start(play)
    steps = 0
    while play.phase is Phase.BRAKING:
        play.step(0.35)
        steps += 1
        assert steps < 1000
    assert steps * play.period_s == pytest.approx(0.050, abs=0.001)


def test_a_moment_without_counts_is_not_a_stop(play):
    brake_from_start(play)
    play.rest(0.045)
    assert play.phase is Phase.BRAKING


def test_a_wheel_that_never_stands_does_not_keep_the_run_from_stopping(play):
    brake_from_start(play)
    for _ in range(120):
        play.step(0.0, wheel_speed=30.0)
    assert play.phase is Phase.STOPPED


@pytest.mark.parametrize("wheel", ["road", "wheel"])
@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.ARMED])
@pytest.mark.parametrize("speed", [5.0, -5.0])
def test_a_wheel_that_turns_before_the_start_is_a_reason_not_to_start(play, wheel, phase, speed):
    play.reach(phase)
    reasons = set()
    for _ in range(20):
        request = play.step(speed if wheel == "road" else 0.0, wheel_speed=speed if wheel == "wheel" else 0.0)
        reasons.add(request.reason)
        assert request.command == Command.SAFE
    assert reasons == {Reason.NONE, Reason.WHEELS_MOVING}
    assert play.phase is phase


def test_wheels_that_keep_turning_never_get_the_drive(play):
    for _ in range(1000):
        request = play.step(3.0)
    assert (play.phase, request.reason) == (Phase.IDLE, Reason.WHEELS_MOVING)


def test_a_nudge_of_four_counts_is_not_a_turning_wheel(play):
    count_rad = 2.0 * math.pi / 2048
    play.rest(0.01)
    assert play.step(4.2 * count_rad / play.period_s).reason is Reason.NONE
    play.rest(0.05)
    assert play.phase is Phase.ARMED
    assert play.step(1.0 * count_rad / play.period_s).reason is Reason.WHEELS_MOVING


def test_a_start_speed_that_is_not_reached_in_time_is_named(play):
    play.reach(Phase.SPIN_UP)
    reasons = [play.step(50.0).reason for _ in range(2100)]
    assert reasons.index(Reason.SPIN_UP_TIMEOUT) * play.period_s == pytest.approx(1.0, abs=2 * play.period_s)
    assert play.phase is Phase.SPIN_UP


def test_a_stop_past_its_time_limit_is_named(play):
    play.reach(Phase.BRAKING)
    reasons = [play.step(50.0).reason for _ in range(1100)]
    assert reasons.index(Reason.BRAKING_TIMEOUT) * play.period_s == pytest.approx(0.5, abs=2 * play.period_s)


def test_the_nominal_run_gives_no_reason(nominal):
    assert {request.reason for _, request in nominal.steps} == {Reason.NONE}


@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE])
def test_after_a_fault_the_phase_machine_requests_nothing(play, phase):
    play.reach(phase)
    asked = len(play.controller.seen)
    play.sequence.phase = Phase.FAULT
    for speed in [0.0] * 400 + [200.0] * 400 + [0.0] * 400:
        assert play.step(speed).command == Command.SAFE
    assert play.phase is Phase.FAULT
    assert len(play.controller.seen) == asked


def test_uneven_ticks_do_not_change_the_times_of_the_phases(encoders):
    play = Play(encoders)
    for tick in range(1000):
        play.step(0.0, periods=(0.5, 1.5, 3.0)[tick % 3])
        if play.phase is not Phase.IDLE:
            break
    # three steps take five periods, and the first sample starts the clock
    assert tick * 5.0 / 3.0 * play.period_s == pytest.approx(0.05, abs=3 * play.period_s)
