from itertools import islice

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.realtime import Beat, PacedClock

PERIOD_NS = 500_000
READS_NS = 300
"""What a few looks at the clock take on a fake clock."""


def on_time(now_ns, deadline_ns):
    return 0 <= now_ns - deadline_ns <= READS_NS


def test_it_returns_the_monotonic_time(fake_time):
    clock = PacedClock(PERIOD_NS)
    assert clock.now_ns() == fake_time.now_ns
    fake_time.spend(123)
    assert clock.now_ns() == fake_time.now_ns


def test_the_first_beat_is_one_period_after_the_first_was_requested(fake_time):
    clock = PacedClock(PERIOD_NS)
    fake_time.spend(10**9)
    beats = iter(clock)
    fake_time.spend(10**9)
    start = fake_time.now_ns
    beat = next(beats)
    assert on_time(beat.deadline_ns, start + PERIOD_NS)
    assert on_time(fake_time.now_ns, beat.deadline_ns)


def test_deadlines_are_multiples_of_the_period_however_long_the_work_takes(fake_time):
    beats = iter(PacedClock(PERIOD_NS))
    first = next(beats)
    for number, beat in enumerate(islice(beats, 10), 1):
        assert beat == Beat(first.deadline_ns + number * PERIOD_NS, 0)
        assert on_time(fake_time.now_ns, beat.deadline_ns)
        fake_time.spend(number * 40_000)


def test_it_wakes_up_before_the_deadline_and_spins_the_rest(fake_time):
    clock = PacedClock(PERIOD_NS)
    for number, beat in enumerate(islice(clock, 4)):
        assert on_time(fake_time.now_ns, beat.deadline_ns)
        assert len(fake_time.slept_ns) == number + 1
        fake_time.spend(123_456)
    for slept_ns in fake_time.slept_ns[1:]:
        assert abs(slept_ns - (PERIOD_NS - 123_456 - clock.spin_ns)) < 1_000


def test_a_wake_up_that_is_late_by_less_than_the_spin_costs_nothing(fake_time):
    clock = PacedClock(PERIOD_NS)
    fake_time.oversleep_ns = clock.spin_ns // 2
    for beat in islice(clock, 20):
        assert on_time(fake_time.now_ns, beat.deadline_ns)


@pytest.mark.untraced
def test_the_spin_follows_how_late_the_machine_wakes_up(fake_time):
    clock = PacedClock(PERIOD_NS)
    beats = iter(clock)
    for _ in islice(beats, 15_000):
        pass
    assert clock.spin_ns <= 20_000  # a machine that is never late needs little of it
    fake_time.oversleep_ns = 70_000
    late = sum(fake_time.now_ns - beat.deadline_ns > READS_NS for beat in islice(beats, 1000))
    assert clock.spin_ns >= 69_000
    assert late <= 7


@pytest.mark.parametrize("period_ns", [100_000, 250_000, 500_000, 20_000_000])
def test_it_never_spins_for_more_than_two_fifths_of_a_period(fake_time, period_ns):
    clock = PacedClock(period_ns)
    fake_time.oversleep_ns = period_ns // 2
    for _ in islice(clock, 500):
        assert clock.spin_ns <= min(0.4 * period_ns, 150_000)


def test_oversleeping_does_not_add_up(fake_time):
    beats = iter(PacedClock(PERIOD_NS))
    first = next(beats)
    fake_time.oversleep_ns = 270_000
    for number, beat in enumerate(islice(beats, 10), 1):
        assert beat == Beat(first.deadline_ns + number * PERIOD_NS, 0)
        assert 100_000 <= fake_time.now_ns - beat.deadline_ns <= 270_000


@pytest.mark.parametrize(
    ("late_ns", "skipped"),
    [
        (0, 0),
        (1, 0),
        (PERIOD_NS - 1_000, 0),
        (PERIOD_NS, 1),
        (2 * PERIOD_NS - 1_000, 1),
        (2 * PERIOD_NS, 2),
        (1000 * PERIOD_NS + 7, 1000),
    ],
)
def test_whole_periods_that_have_passed_are_left_out_and_counted(fake_time, late_ns, skipped):
    beats = iter(PacedClock(PERIOD_NS))
    first = next(beats)
    fake_time.spend(PERIOD_NS + late_ns)
    slept = len(fake_time.slept_ns)
    assert next(beats) == Beat(first.deadline_ns + (1 + skipped) * PERIOD_NS, skipped)
    assert len(fake_time.slept_ns) == slept


def test_after_a_long_pause_there_is_no_burst(fake_time):
    beats = iter(PacedClock(PERIOD_NS))
    next(beats)
    fake_time.spend(50 * PERIOD_NS + 200_000)
    resumed = next(beats)
    assert resumed.skipped == 49
    for number, beat in enumerate(islice(beats, 5), 1):
        assert beat == Beat(resumed.deadline_ns + number * PERIOD_NS, 0)
        assert on_time(fake_time.now_ns, beat.deadline_ns)


@given(
    work=st.lists(
        st.tuples(st.integers(0, 5 * PERIOD_NS), st.sampled_from([0, 0, 1_000, PERIOD_NS, 3 * PERIOD_NS + 1])),
        max_size=40,
    )
)
def test_beats_keep_to_the_grid_and_are_never_early(with_fake_time, work):
    def run(fake):
        clock = PacedClock(PERIOD_NS)
        beats = iter(clock)
        start = grid = next(beats).deadline_ns
        for busy_ns, oversleep_ns in work:
            asked_ns, fake.oversleep_ns, sleeps = fake.now_ns, oversleep_ns, len(fake.slept_ns)
            beat = next(beats)
            slept = len(fake.slept_ns) > sleeps
            grid += (1 + beat.skipped) * PERIOD_NS
            assert beat.deadline_ns == grid
            assert (grid - start) % PERIOD_NS == 0
            assert fake.now_ns >= beat.deadline_ns
            late_ns = fake.now_ns - beat.deadline_ns
            if slept:
                assert beat.skipped == 0
                assert late_ns <= max(READS_NS, oversleep_ns - clock.spin_ns + 20_000)
            else:
                assert late_ns < PERIOD_NS + READS_NS
                assert fake.now_ns <= max(asked_ns, beat.deadline_ns) + READS_NS
            fake.spend(busy_ns)

    with_fake_time(run)
