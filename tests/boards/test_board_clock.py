"""The board's timer as clock and as proof of freshness."""

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.boards.board_clock import BoardClock

HZ = 20_000_000
TICK_NS = 50
WRAP = 1 << 32
PERIOD_NS = 500_000


class Timer:
    """A board's timer, `ppm` fast, released at `released_ns`."""

    def __init__(self, released_ns=0, ppm=0.0):
        self.released_ns = released_ns
        self.rate = 1.0 + ppm * 1e-6

    def at(self, time_ns):
        return int((time_ns - self.released_ns) * self.rate) // TICK_NS % WRAP


def exchanges(count, seed=0, fastest_us=40, slowest_us=250):
    """Start, instant of the reading, and end of exchanges, ns; each way takes an own time."""
    chance = random.Random(seed)
    way = lambda: round(chance.uniform(fastest_us, slowest_us) * 1e3 / 2)  # noqa: E731  short, and used below only
    for i in range(1, count + 1):
        start = i * PERIOD_NS
        taken = start + way()
        yield start, taken, taken + way()


def synchronised(timer, count=400):
    clock = BoardClock(HZ)
    clock.restart(0)
    for start, taken, end in exchanges(count):
        assert clock.instant(timer.at(taken), start, end) >= 0
    return clock, (count + 1) * PERIOD_NS


@pytest.mark.parametrize("ppm", [0.0, 100.0, -100.0, 400.0, -400.0])
def test_time_between_samples_is_the_boards_not_the_computers(ppm):
    timer, clock = Timer(ppm=ppm), BoardClock(HZ)
    clock.restart(0)
    errors = []
    for start, taken, end in exchanges(4000):
        instant = clock.instant(timer.at(taken), start, end)
        assert start <= instant <= end
        errors.append(instant - taken)
    settled = errors[400:]
    steps = [abs(b - a) for a, b in pairwise(settled)]
    assert max(steps) < 25_000  # the host's own stamps: up to 105 us
    assert sorted(steps)[len(steps) // 2] <= TICK_NS + abs(ppm) * 1e-6 * PERIOD_NS


@pytest.mark.parametrize("periods", [1, 2, 3, 80])
def test_a_reading_from_before_the_exchange_is_refused(periods):
    timer = Timer()
    clock, start = synchronised(timer)
    assert clock.instant(timer.at(start + 30_000 - periods * PERIOD_NS), start, start + 100_000) == -1
    assert "older than its request" in clock.fault
    assert clock.instant(timer.at(start + 30_000), start, start + 100_000) >= start


def test_a_timer_that_stands_still_is_refused_from_the_next_exchange_on():
    timer = Timer()
    clock, start = synchronised(timer)
    stands = timer.at(start + 30_000)
    assert clock.instant(stands, start, start + 100_000) >= start
    for i in range(1, 10):
        assert clock.instant(stands, start + i * PERIOD_NS, start + i * PERIOD_NS + 100_000) == -1


@pytest.mark.parametrize(("reading", "words"), [(0, "was reset"), (WRAP // 2 - 1, "faster than the profile says")])
def test_a_timer_that_jumps_is_refused(reading, words):
    clock, start = synchronised(Timer())
    assert clock.instant(reading, start, start + 100_000) == -1
    assert words in clock.fault


@pytest.mark.parametrize("ppm", [2_000, -2_000, 10_000, -10_000, 1_000_000, -500_000])
def test_a_timer_at_another_rate_is_refused_within_a_thousand_exchanges(ppm):
    timer, clock = Timer(ppm=ppm), BoardClock(HZ)
    clock.restart(0)
    assert -1 in [clock.instant(timer.at(taken), start, end) for start, taken, end in exchanges(1000)]


@pytest.mark.parametrize("reading", [10_000, WRAP // 2, WRAP - 1])
def test_after_a_restart_an_answer_from_before_is_refused(reading):
    clock = BoardClock(HZ)
    clock.restart(7_000_000)
    assert clock.instant(reading, 7_001_000, 7_200_000) == -1
    assert clock.instant(2_000, 7_001_000, 7_200_000) >= 7_100_000


@given(wraps=st.integers(0, 5), gap_s=st.floats(0.0, 100.0), within_us=st.integers(0, 400))
def test_a_wrap_and_a_gap_change_nothing(wraps, gap_s, within_us):
    clock = BoardClock(HZ)
    clock.restart(0)
    timer, now = Timer(), 0
    assert clock.instant(0, 0, 0) == 0
    for _ in range(4 * wraps):  # a quarter of a wrap at a time
        now += WRAP * TICK_NS // 4
        assert clock.instant(timer.at(now), now, now) == now
    now += round(gap_s * 1e9)
    taken = now + within_us * 1000
    instant = clock.instant(timer.at(taken), now, now + 400_000)
    assert abs(instant - taken) <= TICK_NS + min(400_000, gap_s * 500_000)


def test_a_pause_of_the_computer_is_seen_by_the_board_as_well():
    timer = Timer()
    clock, start = synchronised(timer)
    before = clock.instant(timer.at(start + 30_000), start, start + 100_000)
    later = start + 20 * PERIOD_NS
    after = clock.instant(timer.at(later + 30_000), later, later + 100_000)
    assert after - before == pytest.approx(20 * PERIOD_NS, abs=3_000)
