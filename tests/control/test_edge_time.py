"""Speeds from the instants of edges: as a board would stamp them, and as samples show them."""

import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control import EdgeTime, MovingAverageSpeed

PER_TURN = 2048
LINE = 2.0 * math.pi / PER_TURN
PERIOD_NS = 500_000
STAMP_NS = 25


def stamped(edges: EdgeTime, angle_of, time_of, ticks: range) -> list[float]:
    """Speeds with the stamps of a 40 MHz clock; `time_of` inverts `angle_of`, which must not fall."""
    speeds = []
    for tick in ticks:
        time_ns = tick * PERIOD_NS
        count = math.floor(angle_of(time_ns * 1e-9) / LINE)
        speeds.append(edges.update(time_ns, count, int(time_of(count * LINE) * 1e9) // STAMP_NS * STAMP_NS))
    return speeds


def sampled(filtered, angle_of, ticks: range) -> list[float]:
    return [
        filtered.update(tick * PERIOD_NS, math.floor(angle_of(tick * PERIOD_NS * 1e-9) / LINE + 0.3)) for tick in ticks
    ]


@pytest.mark.parametrize("speed", [180.0, 12.3, 2.0])
def test_stamped_edges_give_a_constant_speed_to_the_resolution_of_the_stamp(speed):
    seen = stamped(EdgeTime(PER_TURN, 0.0), lambda t: speed * t, lambda a: a / speed, range(1, 400))[20:]
    between_edges_s = LINE / speed
    assert seen == pytest.approx([speed] * len(seen), rel=2.0 * STAMP_NS * 1e-9 / between_edges_s)


def test_stamped_edges_lag_a_stop_by_half_a_period_and_have_no_noise():
    speeds = stamped(
        EdgeTime(PER_TURN, 0.0),
        lambda t: 180.0 * t - 68.0 * t * t,
        lambda a: (180.0 - math.sqrt(180.0**2 - 4.0 * 68.0 * a)) / 136.0,
        range(1, 1000),
    )
    errors = [speed - (180.0 - 136.0 * tick * PERIOD_NS * 1e-9) for tick, speed in enumerate(speeds, start=1)][10:]
    assert statistics.fmean(errors) == pytest.approx(136.0 * 0.5 * PERIOD_NS * 1e-9, abs=0.005)
    assert statistics.stdev(errors) < 0.02


@pytest.mark.parametrize("speed", [180.0, 50.0, 9.0])
def test_without_stamps_a_quick_wheel_is_seen_as_by_the_moving_window(speed):
    edges = sampled(EdgeTime(PER_TURN, 0.010), lambda t: speed * t, range(1000))
    window = sampled(MovingAverageSpeed(PER_TURN, 20), lambda t: speed * t, range(1000))
    assert edges[50:] == pytest.approx(window[50:], rel=1e-12)


@pytest.mark.parametrize("speed", [3.14159, 1.2345, 0.41])
def test_slow_wheel_without_stamps_has_the_noise_of_a_period_not_of_a_count(speed):
    edges = sampled(EdgeTime(PER_TURN, 0.010), lambda t: speed * t, range(4000))[1000:]
    window = sampled(MovingAverageSpeed(PER_TURN, 20), lambda t: speed * t, range(4000))[1000:]
    assert statistics.fmean(edges) == pytest.approx(speed, rel=0.01)
    assert statistics.stdev(edges) < speed * 5e-4 / 0.010 / math.sqrt(6.0) * 1.2
    assert statistics.stdev(edges) < 0.6 * statistics.stdev(window)


def test_samples_beyond_the_highest_rate_make_the_window_shorter():
    crowded = sampled(EdgeTime(PER_TURN, 0.010, rate_hz=500.0), lambda t: 180.0 * t, range(1000))
    shorter = sampled(EdgeTime(PER_TURN, 12 * PERIOD_NS * 1e-9), lambda t: 180.0 * t, range(1000))
    assert crowded[50:] == shorter[50:]


def test_locking_wheel_is_at_most_one_count_over_the_time_since_the_last():
    edges = EdgeTime(PER_TURN, 0.010)
    for tick in range(100):
        before = edges.update(tick * PERIOD_NS, 20 * tick)
    assert before == pytest.approx(20 * LINE / 5e-4)
    for quiet in range(1, 100):
        speed = edges.update((99 + quiet) * PERIOD_NS, 20 * 99)
        assert speed == pytest.approx(LINE / (quiet * 5e-4), rel=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_wheel_that_turns_backwards_has_the_negative_speed(sign):
    speeds = sampled(EdgeTime(PER_TURN, 0.010), lambda t: sign * 20.0 * t, range(200))
    assert statistics.fmean(speeds[50:]) == pytest.approx(sign * 20.0, rel=0.005)


@given(st.lists(st.booleans(), min_size=2, max_size=60))
def test_a_wheel_that_trembles_on_a_line_has_speed_zero(sides):
    edges = EdgeTime(PER_TURN, 0.002)
    assert {edges.update(tick * PERIOD_NS, 7 + side) for tick, side in enumerate(sides)} == {0.0}


def test_the_time_of_an_edge_is_not_known_until_another_comes():
    edges = EdgeTime(PER_TURN, 0.0)
    assert [edges.update(0, 5), edges.update(PERIOD_NS, 15)] == [0.0, 0.0]
    assert edges.update(2 * PERIOD_NS, 25) == pytest.approx(10 * LINE / 5e-4)


def test_the_sample_is_the_edge_unless_the_board_stamped_it():
    by_sample, by_stamp = EdgeTime(PER_TURN, 0.0), EdgeTime(PER_TURN, 0.0)
    for tick in range(5):
        sampled_speed = by_sample.update(tick * PERIOD_NS, 3 * tick)
        stamped_speed = by_stamp.update(tick * PERIOD_NS, 3 * tick, tick * PERIOD_NS - 1000 * tick)
    assert sampled_speed == pytest.approx(3 * LINE / 5e-4)
    assert stamped_speed == pytest.approx(3 * LINE / 4.99e-4)
