import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.realtime import PacedClock
from inteco_abs.signals import UNTIMED, Command, Timing

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

PERIOD_NS = 500_000
READS_US = 0.5
"""What looking at the clock a few times takes on a fake clock."""


def about(*expected):
    return pytest.approx(expected[0] if len(expected) == 1 else expected, abs=READS_US)


def timed_loop(scripted_loop, fake, durations):
    """One tick per row of `durations`: microseconds of exchange, decision and record."""

    def spend(column):
        return lambda tick: fake.spend(round(durations[tick][column] * 1000))

    script = [Command.SAFE] * len(durations)
    return scripted_loop(script, PacedClock(PERIOD_NS), io=spend(0), decide=spend(1), record=spend(2))


def timings(run):
    return [Timing(tick.late_us, tick.io_us, tick.busy_us, tick.skipped) for tick in run.ticks]


def test_lateness_io_and_busy_time_are_those_of_the_clock(scripted_loop, fake_time):
    run = timed_loop(scripted_loop, fake_time, [(100, 40, 5), (80, 30, 7), (60, 0, 0), (0, 1, 1)])
    run.loop.run()
    expected = ((0.0, 100.0, 0.0, 0), (0.0, 80.0, 45.0, 0), (0.0, 60.0, 37.0, 0), (0.0, 0.0, 0.0, 0))
    assert timings(run) == [about(*row) for row in expected]


def test_a_wake_up_later_than_the_spin_can_make_good_is_recorded(scripted_loop, fake_time):
    fake_time.oversleep_ns = 232_000
    run = timed_loop(scripted_loop, fake_time, [(10, 0, 0)])
    run.loop.run()
    assert timings(run) == [about(112.0, 10.0, 0.0, 0)]


def test_busy_time_is_carried_over_into_the_next_slice(scripted_loop, fake_time):
    run = timed_loop(scripted_loop, fake_time, [(100, 40, 5), (80, 30, 7), (60, 0, 0)])
    while not run.loop.run(1):
        pass
    assert [tick.busy_us for tick in run.ticks] == about([0.0, 45.0, 37.0])


def test_the_pipeline_sees_the_timing_that_is_recorded(scripted_loop, fake_time):
    run = timed_loop(scripted_loop, fake_time, [(100, 40, 5), (700, 30, 7), (60, 0, 0)])
    run.loop.run()
    assert [timing for _, _, timing in run.pipeline.seen] == timings(run)


def test_skipped_periods_are_recorded_with_the_tick_after_them_and_added_up(scripted_loop, fake_time):
    run = timed_loop(scripted_loop, fake_time, [(100, 0, 0), (1_700, 0, 0), (100, 0, 0), (10, 5_000, 10), (0, 0, 0)])
    run.loop.run()
    assert [tick.skipped for tick in run.ticks] == [0, 0, 2, 0, 9]
    assert [tick.late_us for tick in run.ticks] == about([0.0, 0.0, 200.0, 0.0, 20.0])
    assert run.loop.skipped == 11


def test_skipped_periods_add_up_over_slices(scripted_loop, fake_time):
    run = timed_loop(scripted_loop, fake_time, [(1_100, 0, 0)] * 5)
    assert run.loop.skipped == 0
    while not run.loop.run(2):
        pass
    assert run.loop.skipped == sum(tick.skipped for tick in run.ticks) > 0


def test_in_virtual_time_nothing_takes_time(scripted_loop):
    run = scripted_loop([Command(0.1, 0.1)] * 20)
    run.loop.run()
    assert {timing for _, _, timing in run.pipeline.seen} == {UNTIMED}
    assert run.loop.skipped == 0


@given(durations=st.lists(st.tuples(*[st.integers(0, 1_500)] * 3), min_size=1, max_size=20))
def test_the_recorded_times_add_up_to_the_time_that_passed(scripted_loop, with_fake_time, durations):
    def run_with(fake):
        start = fake.now_ns
        run = timed_loop(scripted_loop, fake, durations)
        run.loop.run()
        rows = timings(run)
        assert [row.io_us for row in rows] == about([float(io) for io, _, _ in durations])
        assert [row.busy_us for row in rows] == about([0.0, *(float(d + r) for _, d, r in durations[:-1])])
        assert all(0.0 <= row.late_us < PERIOD_NS / 1000 + READS_US for row in rows)
        periods = len(rows) + run.loop.skipped
        last_us = rows[-1].late_us + sum(durations[-1])
        assert fake.now_ns - start == pytest.approx(periods * PERIOD_NS + last_us * 1000, abs=READS_US * 1000)

    with_fake_time(run_with)


def test_the_real_stack_records_the_pauses_of_a_busy_computer(new_stack, fake_time):
    stack = new_stack(beats=PacedClock(PERIOD_NS))
    with stack.board:
        loop, over, slices = stack.loop(), False, 0
        while not over:
            over = loop.run(100)
            slices += 1
            fake_time.spend(3 * PERIOD_NS + 100_000)
    rows = stack.rows()
    assert slices > 3
    assert rows["skipped"].sum() == loop.skipped == 2 * (slices - 1)
    late = [round(row["late_us"]) for row in rows if row["skipped"]]
    assert late == pytest.approx([100] * (slices - 1), abs=2)
    assert sorted(set(rows["dt_s"].round(5).tolist())) == [0.0004, 0.0005, 0.0016]
