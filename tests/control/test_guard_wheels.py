import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.config import load_config
from inteco_abs.control import Guard
from inteco_abs.signals import Command, Estimate, Reason, Sample

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

SEEN = Estimate(0.0, 0.0, 0.0, valid=True)
DRIVE, BRAKE, OFF = Command(1.0, 0.0), Command(0.0, 0.6), Command.SAFE
COUNTS = [2048, 4096]
STRICT = (
    "guard.missed_in_a_row=4",
    "guard.bucket_limit=30",
    "guard.run_up_factor=10",
)  # no drive makes scripted run-ups


class Watched:
    """A guard that watches scripted wheels; times in s since the first sample."""

    def __init__(self, encoders, *settings: str, counts: int = 2048, rate_hz: float = 2000.0) -> None:
        config = load_config(
            settings=[*STRICT, f"encoders.counts_per_turn={counts}", f"loop.rate_hz={rate_hz}", *settings]
        )
        self.guard = Guard(config)
        self.encoders = encoders(counts, rate_hz)
        self.period_s = self.encoders.period_s

    @property
    def reason(self) -> Reason:
        return self.guard.reason

    def see(self, wheel_speed: float, road_speed: float, requested: Command, **timing) -> Command:
        return self.guard.admit(requested, self.encoders.turn(wheel_speed, road_speed, **timing), SEEN)

    def keep(self, wheel_speed: float, road_speed: float, requested: Command, duration_s: float) -> float:
        """Hold speeds and request; time until the guard trips, or `duration_s` if it does not."""
        for step in range(round(duration_s / self.period_s)):
            self.see(wheel_speed, road_speed, requested)
            if self.reason is not Reason.NONE:
                return step * self.period_s
        return duration_s

    def run_up(self, road_speed: float, acceleration: float = 100.0) -> None:
        """Both wheels rolling up to `road_speed` with the drive on."""
        speed = 0.0
        while speed < road_speed:
            speed = min(road_speed, speed + acceleration * self.period_s)
            self.see(speed, speed, DRIVE)
        assert self.reason is Reason.NONE

    def coast(self, road_speed: float, duration_s: float = 0.05) -> None:
        assert self.keep(road_speed, road_speed, OFF, duration_s) == duration_s


@pytest.fixture(params=COUNTS)
def watched(request, encoders):
    return Watched(encoders, counts=request.param)


@pytest.mark.parametrize("wheel", ["wheel", "road", "both"])
def test_a_wheel_above_the_limit_trips_within_6_ms(watched, wheel):
    watched.run_up(240.0)
    fast = {"wheel": (260.0, 240.0), "road": (240.0, 260.0), "both": (260.0, 260.0)}
    assert watched.keep(*fast[wheel], OFF, 0.1) <= 0.006
    assert watched.reason is Reason.OVER_SPEED


def test_a_wheel_just_below_the_limit_does_not_trip(watched):
    watched.run_up(242.0)
    assert watched.keep(242.0, 242.0, DRIVE, 1.0) == 1.0


def test_the_over_speed_limit_is_the_configured_one(encoders):
    watched = Watched(encoders, "guard.over_speed_rad_s=100", "experiment.start_speed_rad_s=50")
    watched.run_up(95.0)
    assert watched.keep(105.0, 105.0, DRIVE, 0.1) <= 0.006
    assert watched.reason is Reason.OVER_SPEED


def test_unstoppable_drive_passes_the_limit_by_one_window_at_most(watched):
    speed = 0.0
    while watched.reason is Reason.NONE:
        speed += 100.0 * watched.period_s
        watched.see(speed, speed, DRIVE)
    assert watched.reason is Reason.OVER_SPEED
    assert 245.0 < speed < 246.0


@pytest.mark.parametrize("duty", [0.2, 0.5, 1.0])
def test_a_road_that_does_not_turn_under_the_drive_trips_within_350_ms(watched, duty):
    watched.keep(0.0, 0.0, OFF, 0.1)
    tripped_s = watched.keep(0.0, 0.0, Command(duty, 0.0), 2.0)
    assert 0.300 <= tripped_s <= 0.352
    assert watched.reason is Reason.ROAD_ENCODER_FROZEN


def test_a_road_at_rest_without_drive_is_not_a_fault(watched):
    assert watched.keep(0.0, 0.0, OFF, 2.0) == 2.0
    assert watched.keep(0.0, 0.0, BRAKE, 2.0) == 2.0
    assert watched.keep(0.0, 0.0, Command(0.19, 0.0), 2.0) == 2.0


def test_a_drive_that_is_off_and_on_again_gets_its_grace_again(watched):
    for _ in range(5):
        assert watched.keep(0.0, 0.0, DRIVE, 0.25) == 0.25
        assert watched.keep(0.0, 0.0, OFF, 0.01) == 0.01


def test_a_road_that_starts_slowly_under_the_drive_is_not_a_fault(watched):
    speed = 0.0
    for _ in range(4000):
        speed += 1.5 * watched.period_s
        watched.see(speed, speed, DRIVE)
    assert watched.reason is Reason.NONE


@pytest.mark.parametrize("speed", [24.0, 40.0, 100.0, 180.0])
@pytest.mark.parametrize("requested", [DRIVE, BRAKE, OFF], ids=["driven", "braked", "coasting"])
def test_a_road_encoder_that_freezes_while_running_trips_within_a_few_ms(watched, speed, requested):
    watched.run_up(speed)
    assert watched.keep(speed, speed, requested, 0.02) == 0.02
    assert watched.keep(speed, 0.0, requested, 1.0) <= 0.002
    assert watched.reason is Reason.ROAD_ENCODER_FROZEN


def test_a_frozen_road_encoder_is_found_when_six_counts_are_owed(encoders):
    watched = Watched(encoders, counts=256)
    watched.run_up(40.0)
    six_counts_s = 6.0 * 2.0 * math.pi / 256 / 40.0
    assert watched.keep(40.0, 40.0, OFF, 0.5) == 0.5
    assert watched.keep(40.0, 0.0, OFF, 1.0) == pytest.approx(six_counts_s, abs=0.0012)
    assert watched.reason is Reason.ROAD_ENCODER_FROZEN


def test_a_coarse_encoder_with_less_than_a_count_per_tick_is_not_a_fault(encoders):
    watched = Watched(encoders, counts=256)
    watched.run_up(180.0)
    speed = 180.0
    while speed > 0.0:
        speed = max(0.0, speed - 140.0 * watched.period_s)
        watched.see(0.8 * speed, speed, BRAKE)
    assert watched.reason is Reason.NONE


def test_a_road_slower_than_75_rpm_may_stand_at_once(watched):
    watched.run_up(8.0)
    assert watched.keep(0.0, 0.0, BRAKE, 1.0) == 1.0


def test_both_encoders_freezing_at_once_trips_within_a_few_ms(watched):
    watched.run_up(100.0)
    assert watched.keep(0.0, 0.0, BRAKE, 1.0) <= 0.002
    assert watched.reason is Reason.ROAD_ENCODER_FROZEN


def test_a_road_encoder_that_freezes_early_in_the_spin_up_is_found_by_the_drive(watched):
    watched.run_up(15.0)
    assert watched.keep(15.0, 0.0, DRIVE, 2.0) <= 0.352
    assert watched.reason is Reason.ROAD_ENCODER_FROZEN


def test_road_encoder_freezing_after_the_grace_is_found_in_50_ms(watched):
    watched.run_up(15.0, acceleration=30.0)
    assert watched.keep(15.0, 0.0, DRIVE, 2.0) <= 0.053
    assert watched.reason is Reason.ROAD_ENCODER_FROZEN


@pytest.mark.parametrize("deceleration", [130.0, 170.0, 400.0])
def test_a_road_that_is_braked_to_rest_is_not_a_fault(watched, deceleration):
    watched.run_up(180.0)
    speed = 180.0
    while speed > 0.0:
        speed = max(0.0, speed - deceleration * watched.period_s)
        watched.see(0.8 * speed, speed, BRAKE)
    assert watched.keep(0.0, 0.0, BRAKE, 1.0) == 1.0


def test_a_wheel_encoder_that_freezes_while_rolling_free_trips_within_20_ms(watched):
    watched.run_up(100.0)
    watched.coast(100.0, 0.3)
    assert watched.keep(0.0, 100.0, OFF, 1.0) <= 0.022
    assert watched.reason is Reason.ENCODERS_DISAGREE


def test_a_wheel_encoder_that_freezes_under_the_drive_trips_within_20_ms(watched):
    watched.run_up(100.0)
    assert watched.keep(0.0, 100.0, DRIVE, 1.0) <= 0.022
    assert watched.reason is Reason.ENCODERS_DISAGREE


def test_a_wheel_encoder_that_never_counts_trips_when_the_road_is_at_300_rpm(watched):
    speed = 0.0
    while watched.reason is Reason.NONE:
        speed += 100.0 * watched.period_s
        watched.see(0.0, speed, DRIVE)
    assert watched.reason is Reason.ENCODERS_DISAGREE
    assert 31.0 < speed < 34.0


@pytest.mark.parametrize("speed", [40.0, 100.0, 180.0])
def test_a_real_lock_under_braking_is_legal(watched, speed):
    watched.run_up(speed)
    watched.coast(speed, 0.3)
    assert watched.keep(0.0, speed, BRAKE, 5.0) == 5.0


def test_a_wheel_that_stays_locked_after_the_release_trips_300_ms_later(watched):
    watched.run_up(150.0)
    watched.keep(0.0, 150.0, BRAKE, 0.5)
    assert 0.300 <= watched.keep(0.0, 150.0, OFF, 2.0) <= 0.322
    assert watched.reason is Reason.ENCODERS_DISAGREE


def test_a_wheel_that_spins_up_again_after_the_release_is_not_a_fault(watched):
    watched.run_up(150.0)
    watched.keep(0.0, 150.0, BRAKE, 0.5)
    watched.keep(0.0, 150.0, OFF, 0.25)
    assert watched.keep(140.0, 150.0, OFF, 1.0) == 1.0


def test_a_wheel_at_rest_on_a_slow_road_is_not_a_fault(watched):
    watched.run_up(30.0)
    assert watched.keep(0.0, 30.0, OFF, 1.0) == 1.0


@pytest.mark.parametrize("rate_hz", [50.0, 250.0, 2000.0, 10_000.0])
def test_a_wheel_that_keeps_running_ahead_of_a_slow_road_trips_50_ms_later(encoders, rate_hz):
    watched = Watched(encoders, "estimator.window_s=0.02", rate_hz=rate_hz)
    watched.run_up(20.0)
    assert 0.050 <= watched.keep(30.0, 20.0, DRIVE, 1.0) <= 0.060
    assert watched.reason is Reason.ENCODERS_DISAGREE


def test_a_wheel_that_a_hand_turns_over_a_road_at_rest_is_not_a_fault(watched):
    assert watched.keep(6.0, 0.0, OFF, 1.0) == 1.0


def test_a_wheel_that_runs_ahead_as_a_road_becomes_slow_has_its_50_ms_too(encoders):
    watched = Watched(encoders, "estimator.window_s=0.1", counts=4096, rate_hz=50.0)
    watched.run_up(60.0)
    assert watched.keep(63.3, 60.0, OFF, 0.3) == 0.3
    for road in (55.0, 50.0, 45.0, 40.0, 35.0, 30.0, 25.0, 20.0):  # in the mean over five periods 30 rad/s
        watched.see(road + 3.3, road, DRIVE)
    assert watched.reason is Reason.NONE


@pytest.mark.parametrize("wheel", ["wheel", "road"])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("periods", [1, 3])
def test_a_count_that_moves_farther_than_300_rad_s_in_one_period_more_trips(encoders, wheel, sign, periods):
    def jump(counts: int) -> Reason:
        watched = Watched(encoders)
        watched.keep(0.0, 0.0, OFF, 0.05)
        sample = watched.encoders.turn(0.0, 0.0, periods=periods)
        moved = {f"{wheel}_count": getattr(sample, f"{wheel}_count") + sign * counts}
        watched.guard.admit(OFF, sample._replace(**moved), SEEN)
        return watched.reason

    possible = math.floor(300.0 * 0.0005 * (periods + 1) * 2048 / (2.0 * math.pi))
    assert jump(possible) is not Reason.COUNT_JUMP
    assert jump(possible + 1) is Reason.COUNT_JUMP


@pytest.mark.parametrize("late", [0.3, 0.6, 0.9])
def test_a_time_stamp_that_is_late_by_less_than_a_period_is_not_a_fault(watched, late):
    watched.run_up(180.0)
    for tick in range(1000):
        sample = watched.encoders.turn(180.0, 180.0)
        stamp_ns = round(late * watched.period_s * 1e9) if tick % 10 == 0 else 0
        watched.guard.admit(DRIVE, sample._replace(time_ns=sample.time_ns + stamp_ns), SEEN)
    assert watched.reason is Reason.NONE


def test_a_count_that_jumps_to_zero_while_running_trips(encoders):
    watched = Watched(encoders)
    watched.run_up(100.0)
    sample = watched.encoders.turn(100.0, 100.0)
    watched.guard.admit(DRIVE, sample._replace(road_count=0), SEEN)
    assert watched.reason is Reason.COUNT_JUMP


def test_a_road_that_counts_backwards_under_the_drive_trips(watched):
    speed = 0.0
    while watched.reason is Reason.NONE:
        speed += 30.0 * watched.period_s
        watched.see(speed, -speed, DRIVE)
    assert watched.reason is Reason.ROAD_BACKWARDS
    assert speed < 8.0


@pytest.mark.parametrize("command", [OFF, DRIVE, BRAKE])
def test_a_road_that_counts_backwards_trips_in_every_phase(watched, command):
    watched.run_up(60.0)
    assert watched.keep(60.0, -60.0, command, 0.1) <= 0.005
    assert watched.reason in (Reason.ROAD_BACKWARDS, Reason.ROAD_ENCODER_FROZEN, Reason.ENCODERS_DISAGREE)


@pytest.mark.parametrize("speed", [20.0, 60.0, 170.0])
@pytest.mark.parametrize("command", [DRIVE, BRAKE])
def test_a_road_encoder_that_only_dithers_is_found_in_20_ms(watched, command, speed):
    watched.run_up(speed)
    still = watched.encoders.turn(speed, speed)
    watched.guard.admit(command, still, SEEN)
    ticks = 0
    while watched.reason is Reason.NONE:
        ticks += 1
        sample = watched.encoders.turn(speed, speed)
        watched.guard.admit(command, sample._replace(road_count=still.road_count + ticks % 2), SEEN)
        assert ticks * watched.period_s < 0.020
    assert watched.reason in (Reason.ROAD_ENCODER_FROZEN, Reason.ENCODERS_DISAGREE)


@pytest.mark.parametrize("road_share", [0.0, 0.1])
def test_road_encoder_dithering_from_rest_is_found_before_the_wheel_is_fast(watched, road_share):
    speed, ticks = 0.0, 0
    still = watched.encoders.turn(0.0, 0.0)
    while watched.reason is Reason.NONE:
        ticks += 1
        speed += 30.0 * watched.period_s
        sample = watched.encoders.turn(speed, road_share * speed)
        road_count = sample.road_count if road_share else still.road_count + ticks % 2
        watched.guard.admit(DRIVE, sample._replace(road_count=road_count), SEEN)
        assert speed < 8.0
    assert watched.reason is Reason.ROAD_ENCODER_FROZEN


@pytest.mark.parametrize("share", [0.5, 2.0, -1.0])
def test_a_wheel_encoder_of_another_scale_or_sign_trips_while_rolling(watched, share):
    speed = 0.0
    while watched.reason is Reason.NONE:
        speed += 30.0 * watched.period_s
        watched.see(share * speed, speed, DRIVE)
        assert speed < 60.0
    assert watched.reason is Reason.ENCODERS_DISAGREE


def test_swapped_encoders_trip_once_the_brake_bites(watched):
    watched.run_up(100.0)
    assert watched.keep(100.0, 100.0, BRAKE, 0.05) == 0.05
    assert watched.keep(100.0, 85.0, BRAKE, 0.1) < 0.02
    assert watched.reason is Reason.ENCODERS_DISAGREE


def test_a_road_that_rocks_back_a_few_counts_under_the_drive_is_not_a_fault(watched):
    watched.keep(0.0, 0.0, OFF, 0.05)
    for speed in [3.0, -3.0] * 5:
        assert watched.keep(speed, speed, DRIVE, 0.02) == 0.02


@pytest.mark.parametrize("stale", [1, 2, 3])
@pytest.mark.parametrize("speed", [100.0, 180.0, 240.0])
def test_the_first_good_sample_after_failed_exchanges_is_not_a_jump(watched, stale, speed):
    watched.run_up(speed)
    for _ in range(stale):
        watched.see(speed, speed, DRIVE, stale=True)
    watched.see(speed, speed, DRIVE)
    assert watched.reason is Reason.NONE
    assert watched.keep(speed, speed, DRIVE, 0.2) == 0.2


@pytest.mark.parametrize("skipped", [1, 2, 3])
@pytest.mark.parametrize("speed", [100.0, 240.0])
def test_a_sample_after_skipped_periods_is_not_a_jump(watched, skipped, speed):
    watched.run_up(speed)
    watched.see(speed, speed, DRIVE, periods=1.0 + skipped)
    assert watched.keep(speed, speed, DRIVE, 0.2) == 0.2


@pytest.mark.parametrize("rate_hz", [100.0, 500.0, 1000.0, 5000.0])
def test_frozen_and_fast_wheels_are_found_at_other_rates(encoders, rate_hz):
    reaction_s = max(0.006, 2.0 / rate_hz)
    frozen, fast = Watched(encoders, rate_hz=rate_hz), Watched(encoders, rate_hz=rate_hz)
    frozen.run_up(100.0)
    assert frozen.keep(100.0, 0.0, DRIVE, 1.0) <= reaction_s
    assert frozen.reason is Reason.ROAD_ENCODER_FROZEN
    fast.run_up(240.0)
    assert fast.keep(260.0, 260.0, DRIVE, 1.0) <= reaction_s
    assert fast.reason is Reason.OVER_SPEED


@given(
    rate_hz=st.sampled_from([100.0, 2000.0, 10_000.0]),
    around=st.lists(st.tuples(st.integers(-1, 1), st.integers(-1, 1)), min_size=2, max_size=300),
)
@example(rate_hz=2000.0, around=[(0, 1), (0, -1)])
@example(rate_hz=2000.0, around=[(1, 0), (-1, 0)])
@example(rate_hz=2000.0, around=[(0, -1), *[(0, 1)] * 10, *[(0, -1)] * 60])
@example(rate_hz=10_000.0, around=[(0, 0), (0, 0), (0, -1), (0, 1)])
def test_counts_of_wheels_that_rest_on_an_edge_are_no_fault(encoders, rate_hz, around):
    guard = Watched(encoders, f"estimator.window_s={10.0 / rate_hz}", rate_hz=rate_hz).guard
    for tick, (wheel, road) in enumerate(around):
        guard.admit(OFF, Sample(tick, round(tick * 1e9 / rate_hz), 1.0 / rate_hz, wheel, road), SEEN)
    assert guard.reason is Reason.NONE


def test_a_road_that_turns_backwards_from_the_start_trips_within_6_ms(watched):
    assert watched.keep(0.0, -20.0, OFF, 1.0) <= 0.006
    assert watched.reason is Reason.ROAD_BACKWARDS


def test_a_wheel_above_the_limit_from_the_start_trips_within_6_ms(watched):
    assert watched.keep(0.0, 260.0, OFF, 1.0) <= 0.006
    assert watched.reason is Reason.OVER_SPEED
