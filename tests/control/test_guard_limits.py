"""Each limit of the guard to the last count and nanosecond: what just keeps to it is admitted, the next thing trips."""

import math

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import Guard
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Command, Estimate, Reason, Sample

SEEN = Estimate(0.0, 0.0, 0.0, valid=True)
DRIVE, BRAKE, OFF = Command(1.0, 0.0), Command(0.0, 0.6), Command.SAFE
COUNTS = 2048
RIM = RigParameters.named("mask").r1 / RigParameters.named("mask").r2
WINDOWS = {2000.0: 10, 100.0: 5}
"""Periods of a speed window, by rate: 5 ms, and not less than five periods."""
START_NS = 7_000_000_000
FROZEN, DISAGREE, BACKWARDS = Reason.ROAD_ENCODER_FROZEN, Reason.ENCODERS_DISAGREE, Reason.ROAD_BACKWARDS


class Counted:
    """A guard and the counts that it sees; speeds are counts in a window, evenly spread."""

    def __init__(self, *settings: str, rate_hz: float = 2000.0, start_ns: int = START_NS) -> None:
        scripted = "guard.run_up_factor=10"  # no drive makes such run-ups
        config = load_config(settings=[f"loop.rate_hz={rate_hz}", "estimator.window_s=0.05", scripted, *settings])
        self.guard = Guard(config)
        self.length = WINDOWS[rate_hz]
        self.period_ns = config.period_ns
        self.count_rad_s = 2.0 * math.pi / COUNTS / (self.length / rate_hz)
        """Speed of one count in a window."""
        self.time_ns = start_ns - self.period_ns
        self.counts = [1000, -3000]
        self.ticks = 0

    def see(self, after_ns: int = 0, requested: Command = OFF, moved: tuple[int, int] = (0, 0)) -> Reason:
        """The guard's reason for the next sample, later and with more counts."""
        self.time_ns += after_ns
        self.counts = [count + step for count, step in zip(self.counts, moved, strict=True)]
        sample = Sample(self.ticks, self.time_ns, self.period_ns * 1e-9, *self.counts)
        self.ticks += 1
        admitted, reason = self.guard.admit(requested, sample, SEEN), self.guard.reason
        assert admitted == (Command.SAFE if reason else requested)
        return reason

    def turn(self, wheel: float, road: float, periods: int, requested: Command = OFF) -> Reason:
        """Its last reason for wheels that turn by these counts in each window; ends where it trips."""
        moved = [0, 0]
        for period in range(1, periods + 1):
            now = [math.floor(period * speed / self.length) for speed in (wheel, road)]
            if self.see(self.period_ns, requested, (now[0] - moved[0], now[1] - moved[1])) is not Reason.NONE:
                break
            moved = now
        return self.guard.reason


@pytest.fixture(params=WINDOWS)
def rate_hz(request):
    return request.param


@pytest.mark.parametrize("sign", [1, -1])
def test_a_speed_that_is_the_limit_itself_is_not_above_it(sign):
    speed = 380 * (2.0 * math.pi / COUNTS * 1e9) / 5_000_000
    for limit, tripped in ((speed, Reason.NONE if sign > 0 else BACKWARDS), (speed - 1e-9, Reason.OVER_SPEED)):
        guarded = Counted(f"guard.over_speed_rad_s={limit!r}")
        assert guarded.turn(sign * 380, sign * 380, 30) is tripped


@pytest.mark.parametrize(("rate_hz", "length"), [(100, 5), (1000, 5), (1400, 7), (2000, 10), (10_000, 50)])
def test_speeds_are_judged_from_the_first_full_window_on(rate_hz, length):
    guard = Guard(load_config(settings=[f"loop.rate_hz={rate_hz}", "estimator.window_s=0.05"]))
    per_sample = round(260.0 / rate_hz * COUNTS / (2.0 * math.pi))
    for tick in range(length + 1):
        assert guard.reason is Reason.NONE
        count = per_sample * tick
        guard.admit(OFF, Sample(tick, round(tick * 1e9 / rate_hz), 1.0 / rate_hz, count, count), SEEN)
    assert guard.reason is Reason.OVER_SPEED


@pytest.mark.parametrize(("late_ns", "tripped"), [(350_000_000, Reason.NONE), (350_000_001, FROZEN)])
def test_a_road_at_rest_has_300_ms_and_50_more_from_the_first_drive_on(late_ns, tripped):
    guarded = Counted()
    guarded.see()
    guarded.see(40_000_000, DRIVE)
    assert guarded.see(late_ns, DRIVE) is tripped


@pytest.mark.parametrize(("late_ns", "tripped"), [(50_000_000, Reason.NONE), (50_000_001, FROZEN)])
def test_a_road_that_has_moved_under_the_drive_has_50_ms_for_its_next_count(late_ns, tripped):
    guarded = Counted()
    guarded.see(0, DRIVE)
    for _ in range(20):
        guarded.see(40_000_000, DRIVE, (1, 1))
    assert guarded.see(late_ns, DRIVE) is tripped


@pytest.mark.parametrize(("duty", "tripped"), [(0.2, FROZEN), (math.nextafter(0.2, 0.0), Reason.NONE)])
def test_a_duty_of_a_fifth_drives(duty, tripped):
    guarded = Counted()
    guarded.see(0, Command(duty, 0.0))
    assert guarded.see(400_000_000, Command(duty, 0.0)) is tripped


@pytest.mark.parametrize(("late_ns", "tripped"), [(300_000, Reason.NONE), (300_001, FROZEN)])
def test_more_than_six_missing_road_counts_trip(late_ns, tripped):
    guarded = Counted()
    guarded.turn(100, 100, 60)  # one count in 50 us
    assert guarded.see(late_ns, BRAKE) is tripped


def test_a_road_slower_than_21_rad_s_owes_nothing():
    assert Counted().count_rad_s * 34 < 21.0 < Counted().count_rad_s * 35
    for road, tripped in ((34, Reason.NONE), (35, FROZEN)):
        guarded = Counted()
        guarded.turn(road, road, 60)
        assert guarded.turn(road, 0, 4, BRAKE) is tripped


def test_deceleration_limit_allows_the_hardest_stop_and_late_stamps(rate_hz):
    def after_a_loss_of(counts):
        guarded = Counted(rate_hz=rate_hz)
        assert guarded.turn(road, road, 100, BRAKE) is Reason.NONE
        return guarded.turn(0, road - counts, guarded.length, BRAKE)

    length, count_rad_s = WINDOWS[rate_hz], Counted(rate_hz=rate_hz).count_rad_s
    road = round(180.0 / count_rad_s)
    memory_s = max(0.020, length / rate_hz)
    most = 400.0 * memory_s / count_rad_s + 2.0 / length * road + 2.0
    assert after_a_loss_of(math.floor(most)) is Reason.NONE
    assert after_a_loss_of(math.floor(most) + 1) is FROZEN


def test_what_a_road_loses_is_reckoned_over_20_ms():
    guarded = Counted()
    assert guarded.turn(0, 50, 60, BRAKE) is Reason.NONE
    assert guarded.turn(0, 30, 10, BRAKE) is Reason.NONE
    assert guarded.turn(0, 20, 10, BRAKE) is FROZEN  # 30 counts of 50 in 10 ms, where 25 may be lost in 20 ms


def test_a_wheel_on_a_fast_road_may_be_a_tenth_and_two_counts_ahead_or_behind(rate_hz):
    def with_wheel_at(counts):
        guarded = Counted(rate_hz=rate_hz)
        assert guarded.turn(road, road, 50) is Reason.NONE
        return guarded.turn(counts, road, guarded.length)

    road = round(60.0 / Counted(rate_hz=rate_hz).count_rad_s)
    most, least = math.floor((1.1 * road + 2.0) / RIM), math.ceil((0.9 * road - 2.0) / RIM)
    assert (with_wheel_at(most), with_wheel_at(most + 1)) == (Reason.NONE, DISAGREE)
    assert (with_wheel_at(least), with_wheel_at(least - 1)) == (Reason.NONE, DISAGREE)


def test_without_a_drive_a_wheel_is_compared_with_a_road_from_31_4_rad_s_on(rate_hz):
    def with_road_at(counts):
        return Counted(rate_hz=rate_hz).turn(3 * counts, counts, 100)

    slow = math.floor(31.4 / Counted(rate_hz=rate_hz).count_rad_s)
    assert (with_road_at(slow), with_road_at(slow + 1)) == (Reason.NONE, DISAGREE)


def test_driven_wheel_may_lead_a_slow_road_by_3_14_rad_s_and_two_counts(rate_hz):
    def with_wheel_at(counts):
        guarded = Counted(rate_hz=rate_hz)
        return guarded.turn(counts, road, guarded.length + round(0.06 * rate_hz), DRIVE)

    count_rad_s = Counted(rate_hz=rate_hz).count_rad_s
    road = round(12.0 / count_rad_s)
    most = math.floor((road + 3.14 / count_rad_s + 2.0) / RIM)
    assert (with_wheel_at(most), with_wheel_at(most + 1)) == (Reason.NONE, DISAGREE)


@pytest.mark.parametrize(("late_ns", "tripped"), [(50_000_000, Reason.NONE), (50_000_001, DISAGREE)])
def test_a_wheel_has_50_ms_to_come_back_to_a_slow_road(late_ns, tripped):
    guarded = Counted()
    guarded.turn(20, 20, 60, DRIVE)
    assert guarded.see(late_ns, DRIVE, (400, 200)) is tripped


def test_wheel_over_three_times_as_fast_as_the_road_shows_lost_road_counts():
    def with_wheel_at(counts):
        return Counted().turn(counts, 10, 150, DRIVE)

    most = math.floor(4 * 10 / RIM)
    assert (with_wheel_at(most), with_wheel_at(most + 1)) == (DISAGREE, FROZEN)


def test_a_road_that_is_pushed_back_by_more_than_two_counts_is_not_compared():
    assert Counted().turn(30, -1, 150, DRIVE) is FROZEN
    assert Counted().turn(30, -3, 150, DRIVE) is Reason.NONE


@pytest.mark.parametrize(("wheel", "road", "tripped"), [(0, 1, BACKWARDS), (1, 0, DISAGREE), (1, 1, BACKWARDS)])
def test_a_wheel_may_turn_back_at_5_rad_s_and_two_counts(rate_hz, wheel, road, tripped):
    def backwards(counts):
        return Counted(rate_hz=rate_hz).turn(-counts * wheel, -counts * road, 100)

    most = math.floor(5.0 / Counted(rate_hz=rate_hz).count_rad_s + 2.0)
    assert (backwards(most), backwards(most + 1)) == (Reason.NONE, tripped)


@pytest.mark.parametrize(("late_ns", "tripped"), [(300_000_000, Reason.NONE), (300_000_001, DISAGREE)])
def test_a_locked_wheel_has_300_ms_from_the_release_on(late_ns, tripped):
    guarded = Counted()
    guarded.turn(100, 100, 50)
    guarded.turn(0, 100, 100, BRAKE)
    guarded.see(500_000, OFF, (0, 10))
    assert guarded.see(late_ns, OFF, (0, late_ns // 50_000)) is tripped


@pytest.mark.parametrize(("duty", "tripped"), [(math.nextafter(0.01, 0.0), DISAGREE), (0.01, Reason.NONE)])
def test_a_duty_of_a_hundredth_brakes(duty, tripped):
    guarded = Counted()
    guarded.turn(100, 100, 50)
    guarded.turn(0, 100, 100, BRAKE)
    assert guarded.turn(0, 100, 700, Command(0.0, duty)) is tripped


@pytest.mark.parametrize("start_ns", [0, START_NS])
def test_a_brake_that_was_never_used_excuses_no_wheel_whenever_the_clock_began(start_ns):
    guarded = Counted(start_ns=start_ns)
    assert guarded.turn(0, 100, 11) is DISAGREE
    assert guarded.ticks == 11
