"""The run-up against what the drive can do: the one check that finds a scale which both encoders share."""

import math
import random
from dataclasses import replace

import pytest

from inteco_abs.config import load_config, parse_config
from inteco_abs.control import Guard
from inteco_abs.rig import DriveMotor, Plant, RigParameters
from inteco_abs.signals import Command, Estimate, Reason, Sample

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

SEEN = Estimate(0.0, 0.0, 0.0, valid=True)
MASK = RigParameters.named("mask")
COUNTS = 2048
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
    """Run a rig up, whose encoders count `scale` times what is believed: what the guard says, and the true speed then.

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
def test_a_scale_within_what_drives_differ_by_passes_and_never_reaches_the_limit(scale):
    reason, true_rad_s = driven(guarded(), scale)
    assert reason is Reason.NONE
    assert true_rad_s < 245.0


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_an_identified_drive_narrows_what_passes(scale):
    assert driven(guarded(*IDENTIFIED), scale)[0] is Reason.RUN_UP_IMPLAUSIBLE
    assert driven(guarded(*IDENTIFIED))[0] is Reason.NONE


def test_an_identification_that_rests_on_a_wrong_scale_does_not_hide_it():
    """It finds the no-load speed at half of what it is, and the counts then fit it."""
    believed = ("model.identified.drive_stall_torque_nm=0.86", "model.identified.drive_no_load_speed_rad_s=150.0")
    assert driven(guarded(*believed), 0.5)[0] is Reason.RUN_UP_IMPLAUSIBLE


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


class Straightened(DriveMotor):
    """A drive with start-up resistors: its torque is kept down until the wheels are fast enough."""

    def torque(self, duty: float, road_speed: float) -> float:
        return min(0.93, super().torque(duty, road_speed)) if road_speed < 105.0 else super().torque(duty, road_speed)


def test_start_up_resistors_as_in_the_vendors_plots_are_no_fault():
    plant = Plant(MASK, 0.0, 0.0, Straightened())
    guard = guarded()
    assert driven(guard, plant=plant, until_rad_s=178.0)[0] is Reason.NONE
    assert 7.0 < plant.time_s < 8.0  # theirs take 6.2 to 6.5 s, so this is harder


@pytest.mark.parametrize(("torque", "speed"), [(0.8, 1.0), (1.2, 1.0), (1.0, 0.85), (1.0, 1.2), (0.8, 0.9)])
def test_a_drive_that_is_a_fifth_off_is_no_fault(torque, speed):
    motor = DriveMotor(1.72 * torque, 300.0 * speed)
    assert driven(guarded(), plant=Plant(MASK, 0.0, 0.0, motor), until_rad_s=178.0)[0] is Reason.NONE


class Failing(DriveMotor):
    """A drive that has no power from a speed on."""

    def torque(self, duty: float, road_speed: float) -> float:
        return super().torque(duty, road_speed) if road_speed < 60.0 else 0.0


def test_a_drive_that_has_no_power_from_a_speed_on_trips_within_two_seconds():
    plant = Plant(MASK, 0.0, 0.0, Failing())
    assert driven(guarded(), plant=plant)[0] is Reason.RUN_UP_IMPLAUSIBLE
    assert plant.time_s < 1.5 + 2.0


def by_hand(guard: Guard, seconds: list[tuple[float, Command]], seed: int = 0) -> Reason:
    """Duties one after the other, each for so long, with ticks that are late by up to half a period."""
    plant, chance, period_s = Plant(MASK, 0.0, 0.0), random.Random(seed), 0.01
    now_s, tick, command = 0.0, 0, Command.SAFE
    for duration_s, wish in seconds:
        for _ in range(round(duration_s / period_s)):
            dt_s = period_s * (1.0 + chance.uniform(0.0, 0.5) - 0.25)
            plant.advance(*command, dt_s)
            now_s, tick = now_s + dt_s, tick + 1
            counts = (math.floor(angle * COUNTS / (2.0 * math.pi)) for angle in (plant.wheel_angle, plant.road_angle))
            command = guard.admit(wish, Sample(tick, round(now_s * 1e9), dt_s, *counts), SEEN)
    return guard.reason


@pytest.mark.parametrize("seed", range(3))
def test_duties_that_change_and_a_brake_between_them_are_no_fault(seed):
    duties = [(3.0, 1.0, 0.0), (2.0, 0.3, 0.0), (1.0, 0.0, 0.0), (2.0, 0.6, 0.0), (0.4, 0.6, 0.5), (2.0, 0.6, 0.0),
              (0.3, 0.0, 0.6), (4.0, 0.9, 0.0)]  # fmt: skip
    hand = [(seconds, Command(drive, brake)) for seconds, drive, brake in duties]
    assert by_hand(guarded("guard.missed_in_a_row=100", rate_hz=100.0), hand, seed) is Reason.NONE


def test_a_low_duty_that_hardly_overcomes_the_friction_is_no_fault():
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
