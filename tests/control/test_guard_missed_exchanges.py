import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.config import load_config
from inteco_abs.control import Guard
from inteco_abs.signals import BoardFlags, Command, Estimate, Reason, Sample

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

CONFIG = load_config(settings=["guard.missed_in_a_row=4", "guard.bucket_limit=30"])
SEEN = Estimate(0.0, 0.0, 0.0, valid=True)
PERIOD_NS = CONFIG.period_ns

GOOD, STALE = (0, False), (0, True)
exchanges = st.tuples(st.sampled_from([0] * 8 + [1, 2, 3]), st.sampled_from([False] * 4 + [True]))


class AtRest:
    """A guard on wheels at rest; each exchange is (periods skipped before it, failed)."""

    def __init__(self, config=CONFIG) -> None:
        self.guard = Guard(config)
        self.time_ns = 0
        self.tick = 0

    def exchange(self, kind: tuple[int, bool], jitter: float = 0.0) -> bool:
        """Whether the guard still admits."""
        skipped, failed = kind
        dt_ns = round(PERIOD_NS * (1 + skipped + jitter))
        self.time_ns += dt_ns
        self.tick += 1
        flags = BoardFlags.STALE if failed else BoardFlags.NONE
        sample = Sample(self.tick, self.time_ns, dt_ns * 1e-9, 0, 0, flags)
        admitted = self.guard.admit(Command(0.1, 0.0), sample, SEEN)
        assert (admitted == Command.SAFE) == (self.guard.reason is not Reason.NONE)
        return self.guard.reason is Reason.NONE

    def good_until_trip(self, kinds) -> int:
        """Number of exchanges that were admitted."""
        admitted = 0
        for kind in kinds:
            if not self.exchange(kind):
                assert self.guard.reason is Reason.MISSED_EXCHANGES
                break
            admitted += 1
        return admitted


def test_the_fourth_failed_exchange_in_a_row_trips():
    assert AtRest().good_until_trip([STALE] * 10) == 3


@pytest.mark.parametrize("skipped", [4, 5, 100])
def test_four_periods_skipped_at_once_trip_at_once(skipped):
    assert AtRest().good_until_trip([(skipped, False)]) == 0


def test_three_periods_skipped_at_once_do_not_trip():
    assert AtRest().good_until_trip([(3, False), GOOD]) == 2


@pytest.mark.parametrize("kinds", [[(1, True), (1, True)], [STALE, (2, True)], [(2, False), (1, True)]])
def test_skipped_periods_and_failed_exchanges_count_the_same(kinds):
    assert AtRest().good_until_trip(kinds) == 1


@pytest.mark.parametrize("kind", [STALE, (1, False)], ids=["failed", "skipped"])
@pytest.mark.parametrize("good", [3, 4, 5, 20])
def test_one_miss_in_every_four_or_more_exchanges_never_trips(kind, good):
    cycle = [kind] + [GOOD] * good
    assert AtRest().good_until_trip(cycle * 500) == 500 * len(cycle)


@pytest.mark.parametrize("kind", [STALE, (1, False)], ids=["failed", "skipped"])
@pytest.mark.parametrize(("good", "misses"), [(0, 4), (1, 15), (2, 28)])
def test_more_misses_than_that_fill_the_bucket(kind, good, misses):
    cycle = [kind] + [GOOD] * good
    assert AtRest().good_until_trip(cycle * 100) == (misses - 1) * len(cycle)


def test_every_period_of_a_long_gap_fills_the_bucket():
    assert AtRest().good_until_trip([(3, False), GOOD] * 10) == 6


def test_good_exchanges_empty_the_bucket_completely():
    config = load_config(settings=["guard.missed_in_a_row=1000", "guard.bucket_limit=28"])
    kinds = [STALE] + [GOOD] * 50 + [STALE] * 9
    assert AtRest(config).good_until_trip(kinds) == len(kinds)


def test_nine_misses_fit_into_the_bucket_and_the_tenth_trips():
    at_rest = AtRest()
    for miss in range(1, 11):
        survives = at_rest.exchange(STALE)
        assert survives == (miss < 10)
        if miss % 3 == 0 and miss < 9:
            at_rest.exchange(GOOD)
            at_rest.exchange(STALE)
            at_rest.exchange(GOOD)
            at_rest.exchange(GOOD)


@given(st.lists(exchanges, max_size=120))
def test_bucket_gains_3_per_miss_and_loses_1_per_success_down_to_zero(kinds):
    at_rest, level, in_a_row = AtRest(), 0, 0
    for kind in kinds:
        bad = kind[0] + kind[1]
        level = level + 3 * bad if bad else max(0, level - 1)
        in_a_row = in_a_row + bad if bad else 0
        trips = level >= 30 or in_a_row >= 4
        assert at_rest.exchange(kind) == (not trips)
        if trips:
            assert at_rest.guard.reason is Reason.MISSED_EXCHANGES
            break


@pytest.mark.parametrize(("periods", "good"), [(1.5, 3), (math.nextafter(1.5, 0.0), 10)])
def test_sample_half_a_period_late_is_a_miss_with_or_without_one_before(periods, good):
    guard = Guard(CONFIG)
    samples = [Sample(tick, tick * PERIOD_NS, periods * PERIOD_NS * 1e-9, 0, 0) for tick in range(10)]
    admitted = [guard.admit(Command(0.1, 0.0), sample, SEEN) for sample in samples]
    assert admitted == [Command(0.1, 0.0)] * good + [Command.SAFE] * (10 - good)


@given(st.lists(st.floats(-0.45, 0.45), min_size=1, max_size=200))
def test_ticks_that_are_late_or_early_by_less_than_half_a_period_are_not_misses(jitters):
    at_rest = AtRest()
    assert all(at_rest.exchange(GOOD, jitter) for jitter in jitters)


@pytest.mark.parametrize(("periods", "admitted"), [(1, 3), (2, 3), (3, 1), (4, 1), (5, 0)])
def test_a_slow_exchange_is_one_miss_or_as_many_as_the_periods_that_it_overran(periods, admitted):
    guard = Guard(CONFIG)
    dt_s = periods * PERIOD_NS * 1e-9
    samples = [Sample(tick, tick * PERIOD_NS, dt_s, 0, 0, BoardFlags.SLOW) for tick in range(5)]
    commands = [guard.admit(Command(0.1, 0.0), sample, SEEN) for sample in samples]
    assert commands == [Command(0.1, 0.0)] * admitted + [Command.SAFE] * (5 - admitted)
    assert guard.reason is Reason.MISSED_EXCHANGES


def test_the_limits_are_the_configured_ones():
    config = load_config(settings=["guard.missed_in_a_row=7", "guard.bucket_limit=1000"])
    assert AtRest(config).good_until_trip([STALE] * 20) == 6
    config = load_config(settings=["guard.missed_in_a_row=1000", "guard.bucket_limit=12"])
    assert AtRest(config).good_until_trip([STALE] * 20) == 3


def test_a_failed_exchange_keeps_the_command_that_was_requested():
    at_rest = AtRest()
    assert at_rest.exchange(STALE)
    assert at_rest.guard.admit(Command(0.3, 0.0), Sample(2, 10**6, 0.0005, 0, 0), SEEN) == Command(0.3, 0.0)


def test_counts_of_a_failed_exchange_are_not_judged():
    at_rest = AtRest()
    sample = Sample(2, at_rest.time_ns + PERIOD_NS, 0.0005, 10**9, -(10**9), BoardFlags.STALE)
    at_rest.guard.admit(Command(0.3, 0.0), sample, SEEN)
    assert at_rest.guard.reason is Reason.NONE
