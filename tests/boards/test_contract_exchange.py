from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.signals import BoardFlags


class TestExchange:
    def test_the_first_sample_is_tick_zero_at_count_zero(self, new_bench):
        bench = new_bench(seed=3)
        with bench.board:
            sample = bench.exchange(periods=7.0)
        assert sample.tick == 0
        assert (sample.wheel_count, sample.road_count) == (0, 0)
        assert sample.dt_s == bench.config.period_ns / 1e9
        assert sample.board_flags is BoardFlags.NONE

    def test_the_first_tick_is_zero_and_one_period_long(self, new_bench):
        bench = new_bench()
        with bench.board:
            for _ in range(5):
                bench.exchange()
            bench.board.begin()
            bench.clock.advance(4 * 10**9)  # until the recorder has made its file
            sample = bench.exchange()
            assert (sample.tick, sample.dt_s) == (0, bench.config.period_ns / 1e9)
            assert bench.exchange().tick == 1

    def test_without_reports_of_its_own_pace_it_is_never_late(self, new_bench):
        bench = new_bench()
        with bench.board as board:
            bench.exchange()
            assert (board.late_ns, board.skipped) == (0, 0)

    def test_driving_turns_both_wheels_and_the_counts_follow_them(self, new_bench):
        bench = new_bench(seed=11)
        road_start, wheel_start = bench.device.counts()
        with bench.board:
            samples = [bench.exchange(1.0) for _ in range(400)]
            road, wheel = bench.device.counts()
        last = samples[-1]
        assert (last.wheel_count, last.road_count) == (wheel - wheel_start, road - road_start)
        assert last.wheel_count > 50
        assert last.road_count > 50
        for counts in ([s.wheel_count for s in samples], [s.road_count for s in samples]):
            assert counts == sorted(counts)

    def test_braking_slows_the_wheels_down(self, new_bench):
        bench = new_bench()
        with bench.board:
            bench.roll()
            fast = bench.device.plant.road_speed
            for _ in range(800):
                bench.exchange(0.0, 0.6)
            assert 0.0 <= bench.device.plant.road_speed < 0.5 * fast

    def test_a_command_acts_until_the_next_one(self, new_bench):
        bench = new_bench()
        with bench.board:
            bench.exchange(1.0, 0.0)
            assert bench.device.duties == (1.0, 0.0)
            bench.clock.advance(9 * 10**7)  # less than an open board's watchdog
            bench.device.catch_up()
            assert bench.device.duties == (1.0, 0.0)
            bench.exchange(0.0, 0.6)
            assert bench.device.duties == (0.0, 0.6)

    def test_the_sample_shows_the_rig_before_its_command_has_acted(self, new_bench):
        bench = new_bench()
        with bench.board:
            sample = bench.exchange(1.0, periods=2000.0)
        assert (sample.wheel_count, sample.road_count) == (0, 0)

    @given(periods=st.lists(st.floats(0.0, 50.0), min_size=1, max_size=12))
    def test_ticks_count_up_and_times_are_the_clocks(self, new_bench, periods):
        bench = new_bench()
        bench.device.seize()
        times = []
        with bench.board:
            samples = []
            for gap in periods:
                samples.append(bench.exchange(0.5, periods=gap))
                times.append(bench.clock.time_ns)
        assert [s.tick for s in samples] == list(range(len(periods)))
        assert [s.time_ns for s in samples] == times
        differences = [(b - a) / 1e9 for a, b in pairwise(times)]
        assert [s.dt_s for s in samples] == [bench.config.period_ns / 1e9, *differences]

    @pytest.mark.parametrize(("duration", "flags"), [(0.0, 0), (1.0, 0), (1.01, BoardFlags.SLOW), (9, BoardFlags.SLOW)])
    def test_exchange_longer_than_a_period_is_slow_and_its_counts_are_good(self, new_bench, duration, flags):
        bench = new_bench()
        with bench.board:
            before = bench.roll()
            bench.device.show(1_000_000, 2_000_000)
            base = bench.exchange()
            bench.device.show(1_000_123, 2_000_456)

            def delay(answer):
                bench.clock.advance(round(duration * bench.config.period_ns))
                return answer

            bench.link.change_answer = delay
            sample = bench.exchange()
            assert sample.board_flags == flags
            # a board that dates its samples was read before the delay
            assert sample.time_ns == (
                base.time_ns + bench.config.period_ns if bench.dates_samples else bench.clock.time_ns
            )
            assert (sample.wheel_count - base.wheel_count, sample.road_count - base.road_count) == (123, 456)
            assert sample.tick == before.tick + 2
            assert bench.board.link_errors == 0
