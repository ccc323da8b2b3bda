import math
from collections import deque

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.control import MovingAverageSpeed, MovingWindow, TwoWheels
from inteco_abs.control.count_speed import empty_window, mean_speeds, window_constants
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Sample

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

TURN = 2.0 * math.pi

lengths = st.integers(1, 40)
turns = st.sampled_from([4, 2048, 4096])
steps_ns = st.integers(1, 10_000_000)
counts = st.integers(-(2**40), 2**40)


@given(lengths, turns, st.lists(st.tuples(steps_ns, counts), min_size=1, max_size=100))
def test_the_speed_is_the_count_difference_over_the_window_by_its_elapsed_time(length, per_turn, track):
    window, kept, time_ns = MovingAverageSpeed(per_turn, length), deque(maxlen=length + 1), 0
    for step_ns, count in track:
        time_ns += step_ns
        kept.append((time_ns, count))
        then_ns, before = kept[0]
        elapsed_s = (time_ns - then_ns) * 1e-9
        expected = (count - before) * TURN / per_turn / elapsed_s if len(kept) > 1 else 0.0
        assert window.update(time_ns, count) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("later_ns", [1_000_000, 999_999])
def test_two_samples_at_one_time_give_no_speed(later_ns):
    window = MovingAverageSpeed(2048, 1)
    window.update(1_000_000, 0)
    assert window.update(later_ns, 5) == 0.0


def test_the_shortest_time_between_two_samples_gives_a_speed():
    window = MovingAverageSpeed(2048, 1)
    window.update(1_000_000, 0)
    assert window.update(1_000_001, 5) == pytest.approx(5 * 2e9 * math.pi / 2048)


tracks = st.lists(st.tuples(st.integers(-1000, 10_000_000), counts, counts), min_size=1, max_size=60)


@given(lengths, turns, tracks)
@example(length=1, per_turn=2048, track=[(0, 0, 0), (1, 5, 7)])
def test_both_wheels_at_once_have_the_speeds_of_each_to_the_last_bit(length, per_turn, track):
    both, k = empty_window(length), window_constants(per_turn, length)
    wheel, road = MovingAverageSpeed(per_turn, length), MovingAverageSpeed(per_turn, length)
    time_ns = 0
    for step_ns, wheel_count, road_count in track:
        time_ns += step_ns
        each = wheel.update(time_ns, wheel_count), road.update(time_ns, road_count)
        assert mean_speeds(k, both, time_ns, wheel_count, road_count) == each


@given(lengths, turns, tracks)
def test_the_moving_window_estimates_as_two_windows_do_to_the_last_bit(length, per_turn, track):
    parameters = RigParameters.named("mask")
    both = MovingWindow(per_turn, length, parameters)
    each = TwoWheels(MovingAverageSpeed(per_turn, length), MovingAverageSpeed(per_turn, length), parameters)
    time_ns = 0
    for number, (step_ns, wheel_count, road_count) in enumerate(track):
        time_ns += step_ns
        sample = Sample(number, time_ns, 0.0005, wheel_count, road_count)
        assert both.update(sample) == each.update(sample)
