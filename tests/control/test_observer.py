"""The observer at rest, in run-up, braking and drive, and with faults on the way."""

import math
from dataclasses import replace
from typing import NamedTuple

import pytest

from inteco_abs.control import Pipeline, PredictiveReaching, Setup, make_controller
from inteco_abs.control.estimators import Observer
from inteco_abs.control.estimators.braking_ekf import EkfTuning
from inteco_abs.rig import EncoderVariation, RigParameters, draw
from inteco_abs.signals import BoardFlags, Command, Phase, Reason, Sample

MASK = RigParameters.named("mask")
HARD = draw("hard", 100_000)
DRIVE = Command(1.0, 0.0)
PREDICTIVE = "controller.name=predictive-reaching"


def law(brake_limit=1.0):
    gains = {gain.name: gain.default for gain in PredictiveReaching.gains}
    controller = PredictiveReaching(Setup(0.2, MASK, 5.0), **gains)
    return lambda seen: Command(0.0, min(brake_limit, controller.update(seen, 0.0005).brake))


class Moment(NamedTuple):
    time_s: float
    road_speed: float
    slip: float
    seen: tuple


def course(run, decide, until_rad_s=2.0, longest_s=8.0, periods=lambda _number: 1):
    """Moments until the road is slow or that time is over."""
    moments = []
    while run.plant.road_speed > until_rad_s and run.plant.time_s < longest_s:
        truth = run.plant.time_s, run.plant.road_speed, run.plant.slip
        moments.append(Moment(*truth, run.tick(decide, periods(len(moments)))))
        assert all(map(math.isfinite, (*moments[-1].seen[:3], *(moments[-1].seen.outlook or ()))))
    return moments


def slip_error(moments, since_s=0.3, above_rad_s=20.0):
    """Largest error of the slip, once it was learnt."""
    fast = [moment for moment in moments if moment.time_s > since_s and moment.road_speed > above_rad_s]
    return max(abs(moment.seen.slip - moment.slip) for moment in fast)


def rms(moments, since_s=0.3, above_rad_s=20.0):
    errors = [m.slip - 0.2 for m in moments if m.time_s > since_s and m.road_speed > above_rad_s]
    return math.sqrt(sum(error**2 for error in errors) / len(errors))


# rest and hands


@pytest.mark.untraced
def test_encoders_that_jitter_at_rest_are_not_mistaken_for_braking(rolling):
    for seed in range(100_000, 100_020):
        run = rolling(draw("hard", seed))
        for _ in range(60):
            seen = run.tick()
            assert seen.outlook is None
            assert abs(seen.road_speed_rad_s) < 10.0 or not seen.valid
        assert abs(seen.road_speed_rad_s) < 1.0
        assert abs(seen.wheel_speed_rad_s) < 1.0


@pytest.mark.parametrize(
    ("wheel", "road", "slip", "braking"),
    [(-8.0, -9.0, 0.0, False), (15.0, 0.0, 0.0, False), (15.0, -20.0, 0.0, False), (0.0, 20.0, 1.0, True)],
    ids=["both backwards", "wheel alone", "against each other", "road alone"],
)
def test_wheels_turned_by_hand_have_their_speeds(encoders, wheel, road, slip, braking):
    hands, observer = encoders(), Observer(MASK, 2048, 0.0005)
    for _ in range(2000):
        seen = observer.update(hands.turn(wheel, road))
    assert (seen.wheel_speed_rad_s, seen.road_speed_rad_s) == pytest.approx((wheel, road), abs=0.5)
    assert seen.slip == pytest.approx(slip, abs=0.02)
    assert (seen.outlook is not None) is braking


# from one mode to the next


def test_a_driven_rig_has_speeds_and_no_outlook_and_rolls(rolling):
    run = rolling(HARD)
    for _ in range(3000):
        seen = run.tick(DRIVE)
        assert seen.outlook is None
        if run.plant.road_speed > 20.0:
            assert seen.road_speed_rad_s == pytest.approx(run.plant.road_speed, abs=0.5)
            assert seen.slip < 0.02


def test_prediction_lasts_from_drive_off_until_drive_on_or_standstill(rolling):
    run = rolling(HARD, 100.0)
    for _ in range(200):
        run.tick(DRIVE)
    ticks = [run.tick(decide).outlook is not None for decide in (DRIVE, Command.SAFE, Command.SAFE, Command.SAFE)]
    assert ticks == [False, False, True, True]  # the observer gets a command one tick after the decision
    for _ in range(400):
        run.tick(law())
    ticks = [run.tick(decide).outlook is not None for decide in (law(), DRIVE, DRIVE, DRIVE)]
    assert ticks == [True, True, False, False]
    slowly = course(run, law(), 0.0)
    for moment in slowly[3:]:
        if abs(moment.road_speed - 2.0) > 0.5:
            assert (moment.seen.outlook is not None) is (moment.road_speed > 2.0)
    assert len(slowly) > 300


@pytest.mark.untraced
def test_discs_far_off_centre_once_learnt_do_not_disturb_the_stop(rolling):
    disc = EncoderVariation(2048, eccentricity_counts=2.0, eccentricity_phase_rad=1.0, jitter_counts=0.3)
    run = rolling(replace(HARD, wheel_encoder=disc, road_encoder=disc), 150.0)
    for _ in range(1500):
        run.tick(DRIVE)
    began_s = run.plant.time_s
    moments = course(run, law())
    assert slip_error(moments, began_s + 0.3) < 0.006
    assert rms(moments, began_s + 0.3) < 0.002


@pytest.mark.untraced
@pytest.mark.parametrize("rate_hz", [500.0, 2000.0, 10_000.0])
def test_speeds_are_handed_over_when_braking_ends(rolling, rate_hz):
    run, decide = rolling(HARD, 30.0, rate_hz), law()
    for _ in range(round(0.02 * rate_hz)):
        run.tick()
    course(run, decide, 3.0)
    for _ in range(round(0.1 * rate_hz)):
        road_speed = run.plant.road_speed
        seen = run.tick(decide)
        assert seen.road_speed_rad_s == pytest.approx(road_speed, abs=1.5)
    assert seen.outlook is None
    assert seen.road_speed_rad_s == pytest.approx(0.0, abs=0.5)


@pytest.mark.untraced
def test_a_second_stop_is_as_good_as_the_first(experiment):
    settings = ("experiment.start_speed_rad_s=60", "experiment.stops=2", "experiment.hold_s=0.05")
    moments = experiment(PREDICTIVE, *settings).run()
    assert {moment.tick.reason for moment in moments} == {Reason.NONE}
    stopped = next(i for i, moment in enumerate(moments) if moment.tick.phase is Phase.STOPPED)
    for half in (moments[:stopped], moments[stopped:]):
        braking = [moment for moment in half if moment.tick.phase is Phase.BRAKING and moment.road_speed > 10.0]
        settled = [moment.slip for moment in braking[len(braking) // 2 :]]
        assert settled == pytest.approx([0.2] * len(settled), abs=0.02)


# samples that are missing, other rates, other encoders


@pytest.mark.untraced
def test_missed_exchanges_leave_the_slip_known_and_held(rolling):
    for missed, every in ((5, 15), (20, 200)):
        run = rolling(HARD, 180.0)
        course(run, Command.SAFE, longest_s=0.05)
        moments = course(run, law(), periods=lambda n, m=missed, e=every: m if n % e == 0 else 1)
        assert slip_error(moments) < 0.012
        assert rms(moments) < 0.004


def test_the_command_before_a_gap_acts_in_the_gap(rolling):
    """Full brake is decided, and 10 ms are missed: the board gets it after them."""
    run = rolling(replace(HARD, brake_dead_time_s=0.01), 180.0)
    course(run, Command.SAFE, longest_s=0.1)
    run.tick(Command.SAFE, periods=20)
    run.written = Command(0.0, 1.0)  # decided before the gap, written after it
    for _ in range(60):
        seen, torque = run.tick(Command(0.0, 1.0)), run.plant.brake_torque
    # 30 ms after the write, 20 ms of which the brake has moved; looked at 10 ms ahead
    assert torque == pytest.approx(9.37 * (1.0 - math.exp(-0.02 / 0.05)), rel=0.2)
    assert seen.outlook.lagged_torque_nm == pytest.approx(9.37 * (1.0 - math.exp(-0.03 / 0.05)), rel=0.03)


@pytest.mark.untraced
def test_flagged_samples_are_passed_over(experiment):
    number = iter(range(10**6))

    def tamper(sample, phase):
        flagged = phase is Phase.BRAKING and next(number) % 20 == 10
        return sample._replace(board_flags=BoardFlags.STALE) if flagged else sample

    moments = experiment(PREDICTIVE, "experiment.start_speed_rad_s=100").run(tamper=tamper)
    assert moments[-1].tick.phase is Phase.DONE
    held = [m.slip for m in moments if m.tick.phase is Phase.BRAKING and 20.0 < m.road_speed < 60.0]
    assert held == pytest.approx([0.2] * len(held), abs=0.01)


@pytest.mark.untraced
@pytest.mark.parametrize(
    ("rate_hz", "error", "held"),
    [
        (50.0, 0.05, 0.3),
        pytest.param(100.0, 0.03, 0.05, marks=pytest.mark.long),
        pytest.param(250.0, 0.01, 0.005, marks=pytest.mark.long),
        pytest.param(1000.0, 0.01, 0.005, marks=pytest.mark.long),
        pytest.param(10_000.0, 0.01, 0.005, marks=pytest.mark.long),
    ],
)
def test_other_rates_of_the_loop(rolling, rate_hz, error, held):
    run = rolling(HARD, 80.0 if rate_hz > 2000.0 else 180.0, rate_hz)
    course(run, Command.SAFE, longest_s=0.05)
    moments = course(run, law())
    assert slip_error(moments) < error
    assert rms(moments) < held


@pytest.mark.long
@pytest.mark.untraced
def test_twice_the_counts_make_the_slip_better_known(rolling):
    errors = []
    for counts in (2048, 4096):
        disc = EncoderVariation(counts, jitter_counts=0.3)
        run = rolling(replace(HARD, wheel_encoder=disc, road_encoder=disc), 180.0)
        course(run, Command.SAFE, longest_s=0.05)
        moments = [moment for moment in course(run, law()) if moment.time_s > 0.3 and moment.road_speed > 20.0]
        errors.append(math.sqrt(sum((moment.seen.slip - moment.slip) ** 2 for moment in moments) / len(moments)))
    assert errors[0] < 0.002
    assert errors[1] < 0.9 * errors[0]


# rigs that differ from the nominal one


def stuck(at):
    return lambda command: Command(command.drive, at)


@pytest.mark.untraced
@pytest.mark.parametrize(
    ("duty", "slip"),
    [(1.0, 1.0), (0.0, 0.0)],
    ids=["stuck full", "does nothing"],
)
def test_a_brake_that_does_not_listen_does_not_mislead_the_slip(rolling, duty, slip):
    run = rolling(HARD, 180.0)
    course(run, Command.SAFE, longest_s=0.05)
    run.acting = stuck(duty)
    moments = course(run, law(), longest_s=1.0)
    assert slip_error(moments) < 0.01
    assert moments[600].slip == pytest.approx(slip, abs=0.01)
    last = moments[-1].seen
    assert last.road_speed_rad_s == pytest.approx(moments[-1].road_speed, abs=0.5)


@pytest.mark.untraced
def test_a_wheel_that_has_locked_is_released_and_its_slip_held_again(rolling):
    run = rolling(HARD, 180.0)
    course(run, Command.SAFE, longest_s=0.05)
    course(run, Command(0.0, 1.0), longest_s=0.45)
    assert run.plant.wheel_speed == 0.0
    moments = course(run, law())
    again = next(moment.time_s for moment in moments if abs(moment.slip - 0.2) < 0.01)
    assert again < 0.45 + 0.35
    assert rms(moments, since_s=again + 0.1) < 0.01


@pytest.mark.untraced
@pytest.mark.parametrize(
    ("variation", "held"),
    [
        ({"brake_gain": 0.6}, 0.01),
        ({"brake_gain": 1.5}, 0.01),
        ({"adhesion_scale": 0.5}, 0.01),
        ({"adhesion_scale": 1.4}, 0.02),
        ({"brake_dead_time_s": 0.0}, 0.01),
        ({"brake_dead_time_s": 0.028}, 0.02),
    ],
)
def test_rigs_far_from_the_published_one_are_held_all_the_same(rolling, variation, held):
    run = rolling(replace(HARD, **variation), 120.0)
    course(run, Command.SAFE, longest_s=0.05)
    moments = course(run, law())
    assert rms(moments) < held
    assert moments[-1].road_speed < 3.0


@pytest.mark.untraced
@pytest.mark.parametrize("variation", [{"brake_gain": 3.0}, {"brake_dead_time_s": 0.15}, {"brake_gain": 0.3}])
def test_rigs_beyond_belief_are_stopped_all_the_same(rolling, variation):
    run = rolling(replace(HARD, **variation), 100.0)
    course(run, Command.SAFE, longest_s=0.05)
    assert course(run, law())[-1].road_speed < 3.0


@pytest.mark.long
@pytest.mark.untraced
def test_a_rig_that_only_coasts_is_followed_to_its_end(rolling):
    run = rolling(HARD, 12.0, 500.0)
    course(run, Command.SAFE, 0.0, longest_s=0.1)
    for moment in course(run, Command(0.0, 0.3), 0.3):
        assert moment.seen.road_speed_rad_s == pytest.approx(moment.road_speed, abs=1.0)


@pytest.mark.untraced
@pytest.mark.parametrize(
    "spread",
    [EkfTuning(wheel_walk_rad_s=math.inf), EkfTuning(torque_sd_nm=math.nan), EkfTuning(adhesion_walk=math.nan)],
    ids=["infinite", "no number", "no number on the way"],
)
def test_a_diverged_observer_ends_the_run_with_the_outputs_off(experiment, spread):
    def broken(config):
        return Pipeline(config, Observer(MASK, 2048, 0.0005, spread), make_controller(config))

    moments = experiment(PREDICTIVE, "experiment.start_speed_rad_s=20", pipeline=broken).run()
    last = moments[-1].tick
    assert (last.phase, last.reason) == (Phase.FAULT, Reason.CONTROLLER_ERROR)
    assert (last.drive, last.brake) == Command.SAFE
    assert len(moments) > 1000  # it was valid during the run-up


def test_a_wheel_that_jumps_is_tracked_again():
    observer = Observer(MASK, 2048, 0.0005)
    per_tick = 180.0 * 2048 / (2.0 * math.pi) * 0.0005
    seen = []
    for tick in range(400):
        counts = int(tick * per_tick) + (5000 if tick >= 300 else 0)
        seen.append(observer.update(Sample(tick, tick * 500_000, 0.0005, counts, counts)))
    assert seen[299].outlook is not None
    assert seen[300].outlook is None
    assert seen[399].outlook is not None
    assert seen[399].road_speed_rad_s == pytest.approx(180.0, rel=0.02)


def test_after_a_long_gap_it_begins_again_at_once():
    observer = Observer(MASK, 2048, 0.0005)
    per_tick = 180.0 * 2048 / (2.0 * math.pi) * 0.0005
    ticks = [*range(300), *range(100_000, 100_100)]
    seen = [observer.update(Sample(t, t * 500_000, 0.0005, int(t * per_tick), int(t * per_tick))) for t in ticks]
    assert seen[299].outlook is not None
    assert seen[300].outlook is None
    assert seen[-1].outlook is not None
    assert seen[-1].road_speed_rad_s == pytest.approx(180.0, rel=0.02)
