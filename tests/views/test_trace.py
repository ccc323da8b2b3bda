import pytest

from inteco_abs.realtime.screen import Point
from inteco_abs.signals import Phase
from inteco_abs.views.trace import RunTrace

PHASES = (Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE)


def points(phases, each_s=1.0, begin_s=7.0, every_s=0.1):
    """So many seconds of each phase."""
    made, count = [], round(each_s / every_s)
    for number, phase in enumerate(phases):
        for step in range(count):
            time_s = begin_s + number * each_s + step * every_s
            made.append(Point(round(time_s * 1e9), 90.0, 100.0, 0.1, int(phase), 0.3))
    return made


@pytest.fixture
def trace():
    return RunTrace(180.0)


def test_before_anything_has_happened_there_is_nothing(trace):
    assert (trace.stop, trace.braked(), trace.seconds_in(Phase.IDLE)) == (0, False, None)
    assert [len(column) for column in trace.columns()] == [0] * 5


def test_phases_last_until_the_next_and_the_present_one_until_now(trace):
    trace.add(points(PHASES[:3]))
    assert [trace.seconds_in(phase) for phase in PHASES[:4]] == pytest.approx([1.0, 1.0, 0.9, None])


def test_traces_are_of_braking_and_of_what_comes_after_until_the_brake_is_off(trace):
    trace.add(points(PHASES))
    times, road, wheel, slip, reference = trace.columns()
    assert times == pytest.approx([number * 0.1 for number in range(20)])
    assert set(road) == {100.0}
    assert set(wheel) == {90.0}
    assert set(slip) == {0.1}
    assert set(reference) == {0.3}


def test_it_is_the_same_whether_ticks_are_added_at_once_or_bit_by_bit(trace):
    other = RunTrace(180.0)
    trace.add(points(PHASES))
    for point in points(PHASES):
        other.add([point])
    assert [column.tolist() for column in other.columns()] == [column.tolist() for column in trace.columns()]
    assert other.entered_ns == trace.entered_ns


def test_a_second_stop_begins_an_empty_trace(trace):
    trace.add(points(PHASES[:5]))
    trace.add(points(PHASES[:3], begin_s=20.0))
    assert (trace.stop, trace.braked(), trace.seconds_in(Phase.BRAKING)) == (2, False, None)
    trace.add(points(PHASES[3:4], begin_s=23.0))
    assert trace.columns()[0][0] == 0.0


def test_what_ends_in_a_fault_keeps_its_traces(trace):
    trace.add(points((*PHASES[:4], Phase.FAULT)))
    assert trace.columns()[0][-1] == pytest.approx(0.9)
    assert trace.stop == 1


@pytest.mark.parametrize(("speed", "span"), [(12.0, 0.1), (40.0, 0.5), (100.0, 1.0), (180.0, 2.0), (240.0, 2.0)])
def test_a_usual_stop_ends_within_its_axis(speed, span):
    trace = RunTrace(speed)
    assert trace.span_s() == span
    assert speed / 128.0 < span


def test_a_stop_that_takes_longer_has_a_longer_axis(trace):
    trace.add(points((Phase.BRAKING,), each_s=2.0))
    assert trace.span_s() == 2.0
    trace.add(points((Phase.BRAKING,), each_s=1.0, begin_s=9.1))
    assert trace.span_s() == 5.0


def test_holding_the_brake_for_long_does_not_change_the_axis(trace):
    trace.add(points((Phase.BRAKING, *(Phase.STOPPED,) * 9)))
    assert trace.span_s() == 2.0
