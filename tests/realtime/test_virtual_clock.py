from itertools import islice

from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.realtime import Beat, VirtualClock


def test_time_starts_at_zero_and_does_not_advance_without_beats():
    clock = VirtualClock(500_000)
    iter(clock)
    assert [clock.now_ns() for _ in range(3)] == [0, 0, 0]


@given(period_ns=st.integers(1, 10**9), count=st.integers(0, 50))
def test_beats_are_one_period_apart_and_nothing_is_ever_skipped(period_ns, count):
    beats = list(islice(VirtualClock(period_ns), count))
    assert beats == [Beat(period_ns * number, 0) for number in range(1, count + 1)]


def test_now_is_the_time_of_the_newest_beat():
    clock = VirtualClock(500_000)
    for beat in islice(clock, 20):
        assert [clock.now_ns() for _ in range(3)] == [beat.deadline_ns] * 3


def test_beats_continue_where_a_part_of_them_was_taken():
    clock = VirtualClock(1_000)
    beats = iter(clock)
    taken = [beat.deadline_ns for length in (3, 0, 1, 4) for beat in islice(beats, length)]
    assert taken == [1_000 * number for number in range(1, 9)]
    assert clock.now_ns() == 8_000


def test_beats_that_were_kept_elsewhere_are_neither_late_nor_skipped():
    clock = VirtualClock(1_000)
    beats = iter(clock)
    next(beats)
    assert clock.on_time
    clock.pass_beats(5)
    assert (clock.now_ns(), next(beats)) == (6_000, Beat(7_000, 0))
    clock.pass_ns(1)
    assert not clock.on_time
