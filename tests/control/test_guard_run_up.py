"""The run-up against what the drive can do: the one check that finds a scale which both encoders share."""

import math
import random
from dataclasses import replace
from functools import partial

import pytest

from inteco_abs.config import load_config, parse_config
from inteco_abs.control import Guard
from inteco_abs.control.run_up import RunUpState, plausible, run_up_constants
from inteco_abs.rig import DriveMotor, Plant, RigParameters
from inteco_abs.rig.actuators import drive_torque
from inteco_abs.signals import Command, Estimate, Reason, Sample

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

SEEN = Estimate(0.0, 0.0, 0.0, valid=True)
MASK = RigParameters.named("mask")
COUNTS = 2048
FIRST_NS = 5_000_000_000
IDENTIFIED = ("model.identified.drive_stall_torque_nm=1.72", "model.identified.drive_no_load_speed_rad_s=300.0")


def guarded(*settings: str, rate_hz: float = 200.0) -> Guard:
    return Guard(load_config(settings=[f"encoders.counts_per_turn={COUNTS}", f"loop.rate_hz={rate_hz}", *settings]))


def driven(
    guard: Guard,
    scale: float = 1.0,
    *,
    until_rad_s: float = 180.0,
    duty: float = 1.0,
    plant: Plant | None = None,
    rate_hz: float = 200.0,
    most_s: float = 30.0,
) -> tuple[Reason, float]:
    """Run a rig up, whose encoders count `scale` times the nominal counts: the guard's reason, and the true speed then.

    It ends at the speed that the guard would see, or once it says something.
    """
    plant = plant or Plant(MASK, 0.0, 0.0)
    period_s, per_rad, tick = 1.0 / rate_hz, COUNTS * scale / (2.0 * math.pi), 0
    command = Command.SAFE
    while guard.reason is Reason.NONE and plant.road_speed * scale < until_rad_s and tick < most_s * rate_hz:
        plant.advance(*command, period_s)
        tick += 1
        counts = (math.floor(angle * per_rad) for angle in (plant.wheel_angle, plant.road_angle))
        command = guard.admit(Command(duty, 0.0), Sample(tick, round(tick * period_s * 1e9), period_s, *counts), SEEN)
    return guard.reason, plant.road_speed


@pytest.mark.parametrize("scale", [0.4, 0.5, 0.6, 0.7, 0.75])
def test_too_few_counts_trip_before_the_road_is_faster_than_the_limit(scale):
    reason, true_rad_s = driven(guarded(), scale)
    assert reason is Reason.RUN_UP_IMPLAUSIBLE
    assert true_rad_s < 235.0


@pytest.mark.parametrize("scale", [1.4, 1.5, 2.0, 2.5])
def test_too_many_counts_trip_before_braking_begins(scale):
    reason, _ = driven(guarded(), scale)
    assert reason is Reason.RUN_UP_IMPLAUSIBLE


@pytest.mark.parametrize("scale", [0.85, 0.95, 1.0, 1.05, 1.2])
def test_scale_within_the_range_of_drives_passes_and_stays_below_the_limit(scale):
    reason, true_rad_s = driven(guarded(), scale)
    assert reason is Reason.NONE
    assert true_rad_s < 245.0


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_an_identified_drive_narrows_what_passes(scale):
    assert driven(guarded(*IDENTIFIED), scale)[0] is Reason.RUN_UP_IMPLAUSIBLE
    assert driven(guarded(*IDENTIFIED))[0] is Reason.NONE


def test_an_identification_that_rests_on_a_wrong_scale_does_not_hide_it():
    """It finds the no-load speed at half of what it is, and the counts then fit it."""
    wrong_drive = ("model.identified.drive_stall_torque_nm=0.86", "model.identified.drive_no_load_speed_rad_s=150.0")
    assert driven(guarded(*wrong_drive), 0.5)[0] is Reason.RUN_UP_IMPLAUSIBLE


@pytest.mark.parametrize("duty", [0.5, 0.7])
def test_other_duties_have_their_own_run_up(duty):
    most_rad_s = 0.8 * 267.0 * (duty - 0.06)
    assert driven(guarded(), duty=duty, until_rad_s=most_rad_s)[0] is Reason.NONE
    reason, true_rad_s = driven(guarded(), 0.5, duty=duty, until_rad_s=most_rad_s)
    assert reason is Reason.RUN_UP_IMPLAUSIBLE
    assert true_rad_s < 245.0


@pytest.mark.parametrize("rate_hz", [50.0, 250.0, 2000.0])
def test_the_rate_of_the_loop_makes_no_difference(rate_hz):
    def run_up(scale: float) -> Reason:
        return driven(guarded("estimator.window_s=0.1", rate_hz=rate_hz), scale, rate_hz=rate_hz)[0]

    assert run_up(1.0) is Reason.NONE
    assert run_up(0.5) is run_up(2.0) is Reason.RUN_UP_IMPLAUSIBLE


def test_start_up_resistors_as_in_the_vendors_plots_are_not_faults(monkeypatch):
    def held_down(k, duty: float, road_speed: float) -> float:
        torque = drive_torque(k, duty, road_speed)
        return min(0.93, torque) if road_speed < 105.0 else torque

    monkeypatch.setattr("inteco_abs.rig.plant.drive_torque", held_down)
    plant = Plant(MASK, 0.0, 0.0)
    guard = guarded()
    assert driven(guard, plant=plant, until_rad_s=178.0)[0] is Reason.NONE
    assert 7.0 < plant.time_s < 8.0  # theirs take 6.2 to 6.5 s, so this is harder


@pytest.mark.parametrize(("torque", "speed"), [(0.8, 1.0), (1.2, 1.0), (1.0, 0.85), (1.0, 1.2), (0.8, 0.9)])
def test_a_drive_that_is_a_fifth_off_is_not_a_fault(torque, speed):
    motor = DriveMotor(1.72 * torque, 300.0 * speed)
    assert driven(guarded(), plant=Plant(MASK, 0.0, 0.0, motor), until_rad_s=178.0)[0] is Reason.NONE


def test_a_drive_that_has_no_power_from_a_speed_on_trips_within_two_seconds(monkeypatch):
    def failing(k, duty: float, road_speed: float) -> float:
        return drive_torque(k, duty, road_speed) if road_speed < 60.0 else 0.0

    monkeypatch.setattr("inteco_abs.rig.plant.drive_torque", failing)
    plant = Plant(MASK, 0.0, 0.0)
    assert driven(guarded(), plant=plant)[0] is Reason.RUN_UP_IMPLAUSIBLE
    assert plant.time_s < 1.5 + 2.0


def by_hand(guard: Guard, seconds: list[tuple[float, Command]], seed: int = 0) -> Reason:
    """Duties one after the other, each for so long, with ticks that are late by up to half a period."""
    plant, chance, period_s = Plant(MASK, 0.0, 0.0), random.Random(seed), 0.01
    now_s, tick, command = 0.0, 0, Command.SAFE
    for duration_s, requested in seconds:
        for _ in range(round(duration_s / period_s)):
            dt_s = period_s * (1.0 + chance.uniform(0.0, 0.5) - 0.25)
            plant.advance(*command, dt_s)
            now_s, tick = now_s + dt_s, tick + 1
            counts = (math.floor(angle * COUNTS / (2.0 * math.pi)) for angle in (plant.wheel_angle, plant.road_angle))
            command = guard.admit(requested, Sample(tick, round(now_s * 1e9), dt_s, *counts), SEEN)
    return guard.reason


@pytest.mark.parametrize("seed", range(3))
def test_duties_that_change_and_a_brake_between_them_are_not_faults(seed):
    duties = [(3.0, 1.0, 0.0), (2.0, 0.3, 0.0), (1.0, 0.0, 0.0), (2.0, 0.6, 0.0), (0.4, 0.6, 0.5), (2.0, 0.6, 0.0),
              (0.3, 0.0, 0.6), (4.0, 0.9, 0.0)]  # fmt: skip
    hand = [(seconds, Command(drive, brake)) for seconds, drive, brake in duties]
    assert by_hand(guarded("guard.missed_in_a_row=100", rate_hz=100.0), hand, seed) is Reason.NONE


def test_a_low_duty_that_hardly_overcomes_the_friction_is_not_a_fault():
    stiff = Plant(replace(MASK, M20=0.3), 0.0, 0.0)
    assert driven(guarded(), duty=0.25, plant=stiff, until_rad_s=30.0, most_s=15.0)[0] is Reason.NONE
    assert 5.0 < stiff.road_speed < 30.0


def test_each_change_of_duty_begins_a_run_up_that_is_judged():
    hand = [(0.5, Command(0.5 + 0.01 * step, 0.0)) for step in range(10)]
    assert by_hand(guarded(rate_hz=100.0), hand) is Reason.NONE
    dragging = [(3.0, Command(0.6, 0.0)), (4.0, Command(0.9, 0.0))]
    guard = guarded("model.identified.drive_stall_torque_nm=3.4", *IDENTIFIED[1:], rate_hz=100.0)
    assert by_hand(guard, dragging) is Reason.RUN_UP_IMPLAUSIBLE


def test_a_session_from_before_the_check_is_judged_without_it():
    text = load_config(settings=[f"encoders.counts_per_turn={COUNTS}", "loop.rate_hz=200"]).to_toml()
    before = parse_config("\n".join(line for line in text.splitlines() if "run_up_factor" not in line))
    assert before.guard.run_up_factor is None
    assert "run_up_factor" not in before.to_toml()
    assert driven(Guard(before), 2.0)[0] is Reason.NONE
    assert driven(Guard(parse_config(text)), 2.0)[0] is Reason.RUN_UP_IMPLAUSIBLE


RATIO = MASK.r2 / MASK.r1
INERTIA = MASK.J2 + MASK.J1 * RATIO**2
FRICTION_NM = MASK.M20 + MASK.M10 * RATIO
DRAG = MASK.d2 + MASK.d1 * RATIO**2
MEAN_RAD_S2 = 29.78
"""Mean acceleration of the published drive's run-up to 178 rad/s, which takes 5.98 s."""
SLACK_RAD_S = 5.0


def run_ups(duty: float, begin_s: float, seconds: float, factor: float) -> tuple[float, float]:
    """Speeds of the slowest and the fastest run-up from rest after so long, in small steps of their own equations."""
    stall_nm, free_rad_s, step_s = 1.72, 300.0, 1e-4
    slow = fast = _published(duty, begin_s - 0.05)
    for _ in range(round((seconds - begin_s) / step_s)):
        torque = stall_nm * (duty - slow / free_rad_s) - 1.5 * FRICTION_NM - DRAG * slow
        slow += step_s / factor * max(0.0, min(torque / INERTIA, MEAN_RAD_S2 * duty))
        torque = stall_nm * duty * (1.0 - fast / free_rad_s) - 0.5 * FRICTION_NM - DRAG * fast
        fast += step_s * factor * torque / INERTIA
    return slow, fast


def _published(duty: float, seconds: float) -> float:
    """Speed of the published rig."""
    falling = 1.72 / 300.0 + DRAG
    return (1.72 * duty - FRICTION_NM) / falling * (1.0 - math.exp(-seconds * falling / INERTIA))


def judge_of(config, factor):
    """Whether the run-up is plausible at a time in ns, with a count of the road, and duties of drive and brake."""
    return partial(plausible, run_up_constants(config, factor), RunUpState())


def last_look_passes(duty: float, looks: int, speed: float, factor: float, *settings: str) -> bool:
    """Whether `speed` is plausible in the last look of 0.1 s, after those of the published rig."""
    fine = 1_000_000  # so that counts are speeds
    config = load_config(settings=[f"encoders.counts_per_turn={fine}", "loop.rate_hz=2000", *settings])
    judge, angle = judge_of(config, factor), 0.0
    assert judge(FIRST_NS, 0, duty, 0.0)
    for look in range(1, looks + 1):
        now_ns = FIRST_NS + look * 100_000_000
        angle += 0.1 * (speed if look == looks else _published(duty, 0.1 * look - 0.05))
        count = round(angle * fine / (2.0 * math.pi))
        assert judge(now_ns - 1, 0, duty, 0.0), "looked at too soon"
        passes = judge(now_ns, count, duty, 0.0)
        assert passes or look == looks
    return passes


@pytest.mark.parametrize(("rate_hz", "look_ns"), [(2000.0, 100_000_000), (100.0, 100_000_000), (50.0, 200_000_000)])
def test_a_look_lasts_a_tenth_of_a_second_and_at_least_ten_periods(rate_hz, look_ns):
    config = load_config(settings=["estimator.window_s=0.1", f"loop.rate_hz={rate_hz}"])
    judge, far = judge_of(config, 1.5), 100 * config.encoders.counts_per_turn
    assert judge(FIRST_NS, 0, 1.0, 0.0)
    assert judge(FIRST_NS + look_ns, 0, 1.0, 0.0)
    assert judge(FIRST_NS + 2 * look_ns - 1, far, 1.0, 0.0)
    assert not judge(FIRST_NS + 2 * look_ns, far, 1.0, 0.0)


@pytest.mark.parametrize(("duty", "looks"), [(1.0, 2), (1.0, 20), (1.0, 60), (1.0, 100), (0.6, 40)])
@pytest.mark.parametrize("factor", [1.5, 1.2])
def test_the_bounds_are_the_slowest_and_the_fastest_run_up_with_some_slack(duty, looks, factor):
    slow, fast = run_ups(duty, 0.1, 0.1 * looks, factor)
    for bound, inside in ((slow - SLACK_RAD_S, 0.2), (fast + SLACK_RAD_S, -0.2)):
        assert last_look_passes(duty, looks, bound + inside, factor)
        assert not last_look_passes(duty, looks, bound - inside, factor)


def test_bounds_of_an_identified_drive_are_the_square_root_of_the_factor():
    slow, fast = run_ups(1.0, 0.1, 4.0, math.sqrt(1.5))
    for bound, inside in ((slow - SLACK_RAD_S, 0.2), (fast + SLACK_RAD_S, -0.2)):
        assert last_look_passes(1.0, 40, bound + inside, 1.5, *IDENTIFIED)
        assert not last_look_passes(1.0, 40, bound - inside, 1.5, *IDENTIFIED)


def test_a_drive_too_weak_to_turn_anything_was_identified_wrongly():
    weak = ("model.identified.drive_stall_torque_nm=0.05", IDENTIFIED[1])
    assert driven(guarded(*weak))[0] is Reason.RUN_UP_IMPLAUSIBLE


def test_after_braking_it_is_checked_again_once_the_brake_is_released():
    """Begun at 60 rad/s, which the brake takes to 20 while its torque dies away: within 0.3 s that is not a fault."""
    config = load_config(settings=[f"encoders.counts_per_turn={COUNTS}", "loop.rate_hz=2000"])
    for late_s, held in ((0.29, True), (0.45, False)):
        judge, angle, now_s, seen = judge_of(config, 1.5), 0.0, 0.0, []
        assert judge(0, 0, 1.0, 0.01)
        while now_s < 2.0:
            now_s += 0.01
            angle += 0.01 * (60.0 if now_s < late_s else 20.0)
            count = round(angle * COUNTS / (2.0 * math.pi))
            seen.append(judge(round(now_s * 1e9), count, 1.0, 0.0))
        assert all(seen[:60]) is held, late_s


@pytest.mark.parametrize("between", [(0.0, 0.0), (1.0, 0.01)])
def test_run_up_after_a_pause_without_drive_or_under_brake_begins_from_rest(between):
    config = load_config(settings=[f"encoders.counts_per_turn={COUNTS}", "loop.rate_hz=2000"])
    judge, angle = judge_of(config, 1.5), 0.0
    for tick in range(300):
        now_s = 0.01 * tick
        resting = 1.0 <= now_s < 1.5
        angle += 0.0 if resting else 0.01 * _published(1.0, now_s if now_s < 1.0 else now_s - 1.5)
        count = round(angle * COUNTS / (2.0 * math.pi))
        assert judge(round(now_s * 1e9), count, *(between if resting else (1.0, 0.0))), now_s
