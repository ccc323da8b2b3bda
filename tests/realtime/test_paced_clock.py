from itertools import islice

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.realtime import Beat, PacedClock

PERIOD_NS = 500_000


def test_it_tells_the_monotonic_time(fake_time):
    clock = PacedClock(PERIOD_NS)
    assert clock.now_ns() == fake_time.now_ns
    fake_time.spend(123)
    assert clock.now_ns() == fake_time.now_ns


def test_the_first_beat_is_one_period_after_the_first_was_asked_for(fake_time):
    clock = PacedClock(PERIOD_NS)
    fake_time.spend(10**9)
    beats = iter(clock)
    fake_time.spend(10**9)
    start = fake_time.now_ns
    assert next(beats) == Beat(start + PERIOD_NS, 0)
    assert fake_time.now_ns == start + PERIOD_NS


def test_deadlines_are_multiples_of_the_period_whatever_the_work_takes(fake_time):
    start = fake_time.now_ns
    for number, beat in enumerate(islice(PacedClock(PERIOD_NS), 10), 1):
        assert beat == Beat(start + number * PERIOD_NS, 0)
        assert fake_time.now_ns == beat.deadline_ns
        fake_time.spend(number * 40_000)


def test_it_sleeps_exactly_until_the_deadline(fake_time):
    for _ in islice(PacedClock(PERIOD_NS), 4):
        fake_time.spend(123_456)
    assert fake_time.slept_ns == [PERIOD_NS, *[PERIOD_NS - 123_456] * 3]


def test_oversleeping_does_not_add_up(fake_time):
    start = fake_time.now_ns
    fake_time.oversleep_ns = 70_000
    for number, beat in enumerate(islice(PacedClock(PERIOD_NS), 10), 1):
        assert beat == Beat(start + number * PERIOD_NS, 0)
        assert fake_time.now_ns - beat.deadline_ns == 70_000


@pytest.mark.parametrize(
    ("late_ns", "skipped"),
    [
        (0, 0),
        (1, 0),
        (PERIOD_NS - 1, 0),
        (PERIOD_NS, 1),
        (2 * PERIOD_NS - 1, 1),
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
    times = []
    for beat in islice(beats, 5):
        times.append(fake_time.now_ns)
        assert beat.skipped == 0
    assert times == [resumed.deadline_ns + number * PERIOD_NS for number in range(1, 6)]


@given(
    work=st.lists(
        st.tuples(st.integers(0, 5 * PERIOD_NS), st.sampled_from([0, 0, 1_000, PERIOD_NS, 3 * PERIOD_NS + 1])),
        max_size=40,
    )
)
def test_beats_keep_to_the_grid_and_are_never_early(with_fake_time, work):
    def run(fake):
        start = grid = fake.now_ns
        beats = iter(PacedClock(PERIOD_NS))
        for busy_ns, oversleep_ns in work:
            asked_ns, fake.oversleep_ns, sleeps = fake.now_ns, oversleep_ns, len(fake.slept_ns)
            beat = next(beats)
            slept = len(fake.slept_ns) > sleeps
            grid += (1 + beat.skipped) * PERIOD_NS
            assert beat.deadline_ns == grid
            assert (grid - start) % PERIOD_NS == 0
            assert fake.now_ns >= beat.deadline_ns
            if slept:
                assert beat.skipped == 0
                assert fake.now_ns == beat.deadline_ns + oversleep_ns
            else:
                assert fake.now_ns == asked_ns
                assert fake.now_ns - beat.deadline_ns < PERIOD_NS
            fake.spend(busy_ns)

    with_fake_time(run)
