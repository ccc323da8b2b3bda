import math
import struct
from fractions import Fraction

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.control import (
    CONTROLLERS,
    ESTIMATORS,
    DecisionState,
    Pipeline,
    Setup,
    advance_and_admit,
    build_pipeline,
    control_check,
)
from inteco_abs.rig import RigParameters
from inteco_abs.signals import (
    UNTIMED,
    BoardFlags,
    BrakeDemand,
    Command,
    Estimate,
    Phase,
    Reason,
    Sample,
    Tick,
    Timing,
)

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

QUICK = ("experiment.start_speed_rad_s=60.0", "experiment.hold_s=0.05", "experiment.idle_s=0.02")
ACTIVE = [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED]
INPUTS = Tick._fields[: Tick._fields.index("wheel_speed_rad_s")]


def exact(tick: Tick) -> tuple[str, ...]:
    """Equal only when every value has the same type and bits, with NaN equal to NaN."""
    return tuple(value.hex() if type(value) is float else repr(value) for value in tick)


def inputs(tick: Tick) -> Sample:
    return Sample(tick.tick, tick.time_ns, tick.dt_s, tick.wheel_count, tick.road_count, tick.board_flags)


class Scripted:
    """Controller whose k-th update, counted from 1, is answered by `answer`."""

    gains = ()
    internals = ()

    def __init__(self, answer) -> None:
        self.answer = answer
        self.calls = 0

    def update(self, _estimate, _dt_s):
        self.calls += 1
        return self.answer(self.calls)


class AsFunction(Scripted):
    """A controller that also gives a function to be compiled."""

    function = staticmethod(lambda *_: BrakeDemand(0.6))


def with_controller(answer, kind=Scripted):
    def make(config):
        parameters = RigParameters.named(config.model.parameters)
        return Pipeline(config, ESTIMATORS[config.estimator.name](config, parameters), kind(answer))

    return make


def at_call(number: int, action):
    return lambda call: action() if call == number else BrakeDemand(0.6, 4.0)


def fail():
    raise ZeroDivisionError("in the user's controller")


def rest(tick: int) -> Sample:
    return Sample(tick, tick * 500_000, 0.0005, 0, 0)


def assert_only_safe_from_now_on(pipeline: Pipeline, last: Tick) -> None:
    reason = pipeline.reason
    for later in range(1, 200):
        sample = inputs(last)._replace(
            tick=last.tick + later,
            time_ns=last.time_ns + later * 500_000,
            wheel_count=last.wheel_count + 20 * later,
            road_count=last.road_count + 20 * later,
        )
        tick = pipeline.step(sample, stop_request=Reason.OPERATOR_STOP if later % 50 == 0 else Reason.NONE)
        assert (tick.drive, tick.brake) == Command.SAFE
        assert (tick.phase, tick.reason) == (Phase.FAULT, reason)


@pytest.fixture(scope="module")
def quick_run(experiment):
    return [moment.tick for moment in experiment(*QUICK).run()]


def test_two_runs_give_identical_ticks(experiment, quick_run):
    again = [moment.tick for moment in experiment(*QUICK).run()]
    assert list(map(exact, again)) == list(map(exact, quick_run))


@pytest.mark.parametrize("settings", [(), ("controller.name=relay",), ("estimator.name=euler",)], ids=str)
def test_recorded_samples_replay_to_identical_ticks(experiment, settings):
    run = experiment(*QUICK, *settings)
    ticks = [moment.tick for moment in run.run()]
    fresh = build_pipeline(run.config)
    assert [exact(fresh.step(inputs(tick))) for tick in ticks] == list(map(exact, ticks))


def test_a_replay_with_another_gain_differs(quick_run):
    config = load_config(settings=[*QUICK, "controller.gains.Mk=2.1"])
    other = build_pipeline(config)
    replayed = [other.step(inputs(tick)) for tick in quick_run]
    differing = {tick.phase for tick, was in zip(replayed, quick_run, strict=True) if exact(tick) != exact(was)}
    assert Phase.BRAKING in differing
    assert not differing & {Phase.IDLE, Phase.ARMED, Phase.SPIN_UP}


def test_a_replay_with_a_stop_that_was_not_there_differs(quick_run, experiment):
    fresh = experiment(*QUICK).pipeline
    middle = len(quick_run) // 2
    for number, was in enumerate(quick_run):
        tick = fresh.step(inputs(was), stop_request=Reason.OPERATOR_STOP if number == middle else Reason.NONE)
        assert (exact(tick) == exact(was)) == (number < middle)


def test_every_tick_carries_its_sample_stop_word_and_timing():
    pipeline = build_pipeline(load_config())
    sample = Sample(7, 10**9, 0.0005, 3, -2, BoardFlags.STALE)
    tick = pipeline.step(sample, stop_request=Reason.SUPERVISOR_LOST, timing=Timing(1.0, 2.0, 3.0, 4))
    assert tick[: len(INPUTS)] == (10**9, 7, 0.0005, 3, -2, BoardFlags.STALE, Reason.SUPERVISOR_LOST)
    assert (tick.late_us, tick.io_us, tick.busy_us, tick.skipped) == (1.0, 2.0, 3.0, 4)


def test_timing_has_no_influence_on_the_decision(quick_run, experiment):
    fresh = experiment(*QUICK).pipeline
    for was in quick_run:
        tick = fresh.step(inputs(was), timing=Timing(1e6, 1e6, 1e6, 1000))
        assert exact(tick._replace(**UNTIMED._asdict())) == exact(was)


def test_every_value_of_a_tick_has_its_plain_type(quick_run):
    kinds = dict.fromkeys(Tick._fields, float)
    kinds |= dict.fromkeys(["time_ns", "tick", "wheel_count", "road_count", "skipped"], int)
    kinds |= {"board_flags": BoardFlags, "phase": Phase, "reason": Reason}
    kinds |= {"stop_request": Reason, "estimate_valid": bool}
    for tick in quick_run:
        assert {name: type(value) for name, value in tick._asdict().items()} == kinds


def test_the_reference_is_logged_while_braking_and_is_nan_otherwise(quick_run):
    for tick in quick_run:
        if tick.phase is Phase.BRAKING:
            assert tick.slip_reference == 0.2
        else:
            assert math.isnan(tick.slip_reference)


def test_drive_and_brake_are_never_on_together_nor_in_the_wrong_phase(quick_run):
    assert {tick.phase for tick in quick_run if tick.drive} == {Phase.SPIN_UP}
    assert {tick.phase for tick in quick_run if tick.brake} == {Phase.BRAKING, Phase.STOPPED}
    first = next(tick for tick in quick_run if tick.phase is Phase.BRAKING)
    assert (first.drive, first.brake) == Command.SAFE


def test_the_nominal_stop_has_the_expected_quality(nominal_run):
    braking = [moment for moment in nominal_run if moment.tick.phase is Phase.BRAKING]
    begin_s = braking[0].tick.time_ns * 1e-9
    settled = [
        moment.slip - 0.2
        for moment in braking
        if moment.tick.time_ns * 1e-9 - begin_s > 0.40 and moment.road_speed > 10.0
    ]
    assert math.sqrt(sum(error**2 for error in settled) / len(settled)) < 0.012
    stopped_s = next(moment.tick.time_ns * 1e-9 for moment in braking if moment.road_speed < 0.5)
    assert stopped_s - begin_s == pytest.approx(1.406, rel=0.02)


def test_finished_phase_and_reason_follow_the_newest_tick(experiment):
    run = experiment(*QUICK)
    assert (run.pipeline.phase, run.pipeline.reason, run.pipeline.finished) == (Phase.IDLE, Reason.NONE, False)
    for moment in run.moments():
        assert run.pipeline.phase is moment.tick.phase
        assert run.pipeline.reason is moment.tick.reason
        assert run.pipeline.finished == (moment.tick.phase in (Phase.DONE, Phase.FAULT))
    assert run.pipeline.phase is Phase.DONE
    assert run.pipeline.error is None


@pytest.mark.parametrize("phase", ACTIVE)
def test_a_stop_request_takes_the_outputs_away_at_that_same_tick(experiment, phase):
    run = experiment(*QUICK)
    moments = run.run(stop_when=lambda at: at is phase)
    before, last = moments[-2].tick if len(moments) > 1 else None, moments[-1].tick
    assert last.stop_request is Reason.OPERATOR_STOP
    assert (last.phase, last.reason) == (Phase.FAULT, Reason.OPERATOR_STOP)
    assert (last.drive, last.brake) == Command.SAFE
    assert before is None or (before.phase, before.reason) == (phase, Reason.NONE)
    assert_only_safe_from_now_on(run.pipeline, last)


def test_a_stop_request_at_the_very_first_tick_is_obeyed():
    pipeline = build_pipeline(load_config())
    tick = pipeline.step(rest(0), stop_request=Reason.OPERATOR_STOP)
    assert (tick.phase, tick.reason) == (Phase.FAULT, Reason.OPERATOR_STOP)
    assert_only_safe_from_now_on(pipeline, tick)


@pytest.mark.parametrize("flag", [BoardFlags.STALE, BoardFlags.SLOW])
@pytest.mark.parametrize("phase", ACTIVE)
def test_untrusted_samples_change_neither_phase_estimate_nor_request(experiment, phase, flag):
    run = experiment(*QUICK)
    good = next(moment.tick for moment in run.moments() if moment.tick.phase is phase)
    requests = good.drive_request, good.brake_request
    for later in range(1, 111):
        sample = inputs(good)._replace(tick=good.tick + later, time_ns=good.time_ns + later * 500_000, board_flags=flag)
        tick = run.pipeline.step(sample)
        assert (tick.phase, tick.reason) == (phase, Reason.NONE)
        assert (tick.drive_request, tick.brake_request) == requests
        assert (tick.road_speed_rad_s, tick.slip) == (good.road_speed_rad_s, good.slip)


def test_a_braking_run_continues_after_failed_exchanges_and_still_stops(experiment):
    run, last_good, braking = experiment(*QUICK), [], 0

    def tamper(sample, phase):
        nonlocal braking
        braking += phase is Phase.BRAKING
        if 120 < braking <= 230:
            return last_good[0]._replace(
                tick=sample.tick, time_ns=sample.time_ns, dt_s=sample.dt_s, board_flags=BoardFlags.STALE
            )
        last_good[:] = [sample]
        return sample

    moments = run.run(tamper=tamper)
    assert moments[-1].tick.phase is Phase.DONE
    assert next(moment.road_speed for moment in moments if moment.tick.phase is Phase.STOPPED) < 0.5


@pytest.mark.parametrize("call", [1, 2, 50])
def test_a_controller_that_raises_ends_the_run_and_its_error_is_kept(experiment, call):
    run = experiment(*QUICK, pipeline=with_controller(at_call(call, fail)))
    last = run.run()[-1].tick
    assert (last.phase, last.reason) == (Phase.FAULT, Reason.CONTROLLER_ERROR)
    assert (last.drive, last.brake) == (last.drive_request, last.brake_request) == Command.SAFE
    assert last.torque_demand_nm == 0.0
    assert isinstance(run.pipeline.error, ZeroDivisionError)
    assert str(run.pipeline.error) == "in the user's controller"
    assert_only_safe_from_now_on(run.pipeline, last)


def test_a_controller_that_raised_is_not_asked_again(experiment):
    controller = Scripted(lambda _call: fail())
    run = experiment(
        *QUICK,
        pipeline=lambda config: Pipeline(config, ESTIMATORS["euler"](config, RigParameters.named("mask")), controller),
    )
    last = run.run()[-1].tick
    assert_only_safe_from_now_on(run.pipeline, last)
    assert controller.calls == 1


def test_the_estimator_gets_what_the_exchange_of_its_sample_wrote():
    received = []

    class Listening:
        def update(self, _sample, command):
            received.append(command)
            return Estimate(0.0, 0.0, 0.0, valid=True)

    pipeline = Pipeline(load_config(), Listening(), Scripted(lambda _call: BrakeDemand(0.0)))
    written = []
    for number in range(1500):
        written.append(pipeline.command)
        pipeline.step(rest(number))
    assert received == written
    assert len(set(received)) > 1


class Tuned(Scripted):
    """A controller whose gain `force` can change; changing `weak` fails."""

    force, reference = 0.6, 0.2

    def __init__(self) -> None:
        super().__init__(lambda _call: BrakeDemand(self.force))
        self.changed = []

    def change_gain(self, name, value):
        self.changed.append(name)
        if name == "weak":
            fail()
        self.force = value


def tuned(stops=1):
    config = load_config(settings=[f"experiment.stops={stops}"])
    return Pipeline(config, ESTIMATORS["euler"](config, RigParameters.named("mask")), Tuned())


def test_a_changed_gain_is_the_controllers_and_a_changed_reference_is_the_slip_to_hold():
    pipeline = tuned()
    pipeline.change("force", 0.4)
    assert (pipeline.machine.controller.force, pipeline.reference_slip) == (0.4, 0.2)
    pipeline.change("reference_slip", 0.3)
    assert (pipeline.machine.controller.reference, pipeline.reference_slip) == (0.3, 0.3)
    assert pipeline.error is None


@pytest.mark.parametrize("stops", [1, 2])
def test_a_gain_is_changed_once_in_the_controller_of_this_stop_and_once_in_that_of_the_next(stops):
    pipeline = tuned(stops)
    pipeline.change("force", 0.4)
    machine = pipeline.machine
    assert machine.controller.changed == machine.controller_as_made.changed == ["force"]
    assert machine.controller_as_made.force == 0.4


def test_a_change_that_raises_ends_the_run_and_no_gain_changes_after_it():
    pipeline = tuned()
    pipeline.change("weak", 1.0)
    pipeline.change("force", 0.4)
    assert isinstance(pipeline.error, ZeroDivisionError)
    assert pipeline.machine.controller.force == 0.6
    tick = pipeline.step(rest(0))
    assert (tick.phase, tick.reason) == (Phase.FAULT, Reason.CONTROLLER_ERROR)
    assert_only_safe_from_now_on(pipeline, tick)


def test_a_controller_that_wants_to_exit_ends_the_run_and_not_the_loop(experiment):
    def leave(_call):
        raise SystemExit(0)

    run = experiment(*QUICK, pipeline=with_controller(leave))
    last = run.run()[-1].tick
    assert (last.phase, last.reason) == (Phase.FAULT, Reason.CONTROLLER_ERROR)


@pytest.mark.parametrize("call", [1, 2, 300])
def test_an_estimator_that_raises_ends_the_run_and_its_error_is_kept(call):
    config = load_config()
    calls = 0

    class Failing:
        def update(self, _sample, _command):
            nonlocal calls
            calls += 1
            return fail() if calls == call else Estimate(0.0, 0.0, 0.0, valid=True)

    pipeline = Pipeline(config, Failing(), Scripted(lambda _call: BrakeDemand(0.0)))
    for number in range(call):
        tick = pipeline.step(rest(number))
    assert (tick.reason, tick.phase) == (Reason.CONTROLLER_ERROR, Phase.FAULT)
    assert (tick.wheel_speed_rad_s, tick.road_speed_rad_s, tick.slip, tick.estimate_valid) == (0.0, 0.0, 0.0, False)
    assert isinstance(pipeline.error, ZeroDivisionError)
    assert_only_safe_from_now_on(pipeline, tick)


@pytest.mark.parametrize(
    "answer",
    [
        None,
        0.5,
        (0.5,),
        "0.5",
        Command(0.0, 0.5),
        BrakeDemand,
        BrakeDemand(0.5, internals=()),
        BrakeDemand(0.5, internals=(1.0, 2.0, 3.0)),
        BrakeDemand(0.5, internals=(1.0, 2.0, 3.0, 4.0, 5.0)),
        BrakeDemand(0.5, internals=None),
    ],
    ids=repr,
)
def test_controller_returning_a_wrong_type_ends_the_run_not_the_loop(experiment, answer):
    run = experiment(*QUICK, pipeline=with_controller(lambda _call: answer))
    last = run.run()[-1].tick
    assert last.phase is Phase.FAULT
    assert last.reason in (Reason.CONTROLLER_ERROR, Reason.BAD_OUTPUT)
    assert (last.drive, last.brake) == Command.SAFE
    if last.reason is Reason.CONTROLLER_ERROR:
        (where,) = run.pipeline.error.__notes__
        assert "test_pipeline.py" in where
    if type(answer) is not BrakeDemand:
        assert str(run.pipeline.error).startswith("update() must return a BrakeDemand, not ")


@pytest.mark.parametrize("brake", [math.nan, math.inf, None, True, "0.5", np.float64("nan"), np.ones(1)], ids=repr)
@pytest.mark.parametrize("kind", [Scripted, AsFunction])
def test_a_duty_that_is_not_finite_is_never_sent(experiment, brake, kind):
    run = experiment(*QUICK, pipeline=with_controller(at_call(20, lambda: BrakeDemand(brake)), kind))
    last = run.run()[-1].tick
    assert (last.phase, last.reason) == (Phase.FAULT, Reason.BAD_OUTPUT)
    assert (last.drive, last.brake) == Command.SAFE
    assert run.pipeline.error is None


@pytest.mark.parametrize("brake", [1, np.float64(0.5), np.float32(0.5), np.int64(1), Fraction(1, 2)], ids=repr)
def test_a_duty_may_be_any_kind_of_number(experiment, brake):
    run = experiment(*QUICK, pipeline=with_controller(lambda _call: BrakeDemand(brake)))
    ticks = [moment.tick for moment in run.run()]
    assert ticks[-1].reason is Reason.NONE
    assert {(type(tick.brake_request), tick.brake_request) for tick in ticks} == {(float, 0.0), (float, float(brake))}


@pytest.mark.parametrize(
    "demand",
    [
        BrakeDemand(None),
        BrakeDemand("0.5"),
        BrakeDemand([]),
        BrakeDemand(0.5, torque_nm=None),
        BrakeDemand(0.5, torque_nm=10**400),
        BrakeDemand(0.5, switching="x"),
        BrakeDemand(0.5, internals=(None, 0.0, 0.0, 0.0)),
        BrakeDemand(0.5, internals="wxyz"),
    ],
    ids=lambda demand: repr(demand)[:70],
)
def test_every_demand_of_a_controller_can_be_recorded(experiment, demand):
    run = experiment(*QUICK, pipeline=with_controller(at_call(20, lambda: demand)))
    for moment in run.moments():
        tick = moment.tick
        numbers = tick.switching, tick.torque_demand_nm, tick.drive_request, tick.brake_request, *tick[-8:-4]
        assert len(struct.pack("<8d", *numbers)) == 64


@pytest.mark.parametrize("demand", [BrakeDemand(1, 4, 2.0), BrakeDemand(1, 4, 2)], ids=repr)
def test_whole_numbers_of_a_demand_are_logged_as_floats(experiment, demand):
    run = experiment(*QUICK, pipeline=with_controller(lambda _call: demand))
    tick = next(moment.tick for moment in run.moments() if moment.tick.torque_demand_nm)
    assert repr((tick.brake_request, tick.torque_demand_nm, tick.switching)) == "(1.0, 4.0, 2.0)"


@pytest.mark.parametrize(("requested", "sent"), [(1.0, 0.7), (0.7, 0.7), (0.3, 0.3), (-0.5, 0.0), (1e308, 0.7)])
def test_request_and_command_are_both_logged_and_the_guard_has_the_last_word(experiment, requested, sent):
    run = experiment(*QUICK, "guard.brake_limit=0.7", pipeline=with_controller(lambda _call: BrakeDemand(requested)))
    asked = 0
    for moment in run.moments():
        tick = moment.tick
        if tick.phase is Phase.BRAKING and tick.brake_request:
            assert (tick.brake_request, tick.brake) == (requested, sent)
            asked += 1
            if asked == 100:
                break
    assert asked == 100


def test_the_demand_of_the_controller_is_logged(experiment):
    demand = BrakeDemand(0.5, 4.5, -0.05, (1.0, 2.0, 3.0, 4.0))
    run = experiment(*QUICK, pipeline=with_controller(lambda _call: demand))
    logged = [
        (tick.brake_request, tick.torque_demand_nm, tick.switching, (tick.c0, tick.c1, tick.c2, tick.c3))
        for tick in (moment.tick for moment in run.run())
        if tick.phase is Phase.BRAKING
    ]
    assert set(logged[1:]) == {(*demand[:3], demand.internals)}


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (("experiment.spin_up_timeout_s=0.3",), Reason.SPIN_UP_TIMEOUT),
        (("experiment.braking_timeout_s=0.2",), Reason.BRAKING_TIMEOUT),
    ],
    ids=["spin-up", "braking"],
)
def test_a_timeout_ends_the_run_with_its_reason(experiment, settings, reason):
    last = experiment(*QUICK, *settings).run()[-1].tick
    assert (last.phase, last.reason) == (Phase.FAULT, reason)
    assert (last.drive, last.brake) == Command.SAFE


@pytest.mark.parametrize("at", [5, 60])
def test_a_wheel_that_moves_before_the_start_ends_the_run_with_its_reason(at):
    pipeline = build_pipeline(load_config(settings=["experiment.idle_s=0.02"]))
    for number in range(at + 20):
        moved = max(0, number - at)
        tick = pipeline.step(rest(number)._replace(wheel_count=moved))
    assert (tick.phase, tick.reason) == (Phase.FAULT, Reason.WHEELS_MOVING)
    assert_only_safe_from_now_on(pipeline, tick)


def test_the_first_of_several_reasons_is_kept(experiment):
    run = experiment(*QUICK, pipeline=with_controller(lambda _call: fail()))
    for moment in run.moments(stop_when=lambda at: at is Phase.BRAKING):
        last = moment.tick
    assert last.reason is Reason.OPERATOR_STOP


def test_the_pipeline_uses_the_configured_parts():
    config = load_config(settings=["controller.name=relay", "estimator.name=euler"], checks=[control_check()])
    parameters = RigParameters.named("mask")
    by_hand = Pipeline(
        config,
        ESTIMATORS["euler"](config, parameters),
        CONTROLLERS["relay"](Setup(0.2, parameters, 5.0), on_duty=1.0, off_duty=0.0),
    )
    built = build_pipeline(config)
    for number in range(400):
        sample = rest(number)._replace(road_count=max(0, number - 210), wheel_count=max(0, number - 210))
        assert exact(built.step(sample)) == exact(by_hand.step(sample))


def test_machine_and_guard_as_functions_decide_as_the_pipeline_does(quick_run):
    """Monte Carlo and compiled replays call them with the controller's newest duty."""
    pipeline, other = (build_pipeline(load_config(settings=QUICK)) for _ in range(2))
    machine, guard, compared = other.machine, other.guard, 0
    for number, was in enumerate(quick_run):
        sample = inputs(was)._replace(board_flags=BoardFlags.STALE if number % 7 == 3 else BoardFlags.NONE)
        stop = Reason.OPERATOR_STOP if number == len(quick_run) - 5 else Reason.NONE
        tick = pipeline.step(sample, stop)
        demand = tick.brake_request, tick.torque_demand_nm, tick.switching, tick.c0, tick.c1, tick.c2, tick.c3
        decided = pipeline.decided
        if tick.phase is Phase.BRAKING and not sample.board_flags:
            seen = tick.wheel_speed_rad_s, tick.road_speed_rad_s, tick.slip, tick.estimate_valid
            assert repr(decided) == repr(DecisionState(*seen, *demand, tick.drive, tick.brake))
            compared += 1
        advance_and_admit((machine.k, guard.k), (machine, guard), sample, decided.demanded, stop)
        found = machine.phase, machine.drive_request, machine.brake_request, guard.drive, guard.brake, guard.reason
        assert found == (tick.phase, tick.drive_request, tick.brake_request, tick.drive, tick.brake, tick.reason)
    assert compared > 100
    assert tick.reason is Reason.OPERATOR_STOP
