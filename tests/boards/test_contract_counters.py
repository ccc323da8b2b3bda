from itertools import accumulate

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

raw_counts = st.integers(-(2**31), 2**31 - 1)
steps = st.integers(-(2**31) + 1, 2**31 - 1) | st.integers(-300, 300)


class TestCounters:
    @given(start=st.tuples(raw_counts, raw_counts), moves=st.lists(st.tuples(steps, steps), max_size=20))
    @example(start=(2**31 - 1, -(2**31)), moves=[(1, -1), (-1, 1)])
    @example(start=(-1, 0), moves=[(1, -1), (-1, 1)])
    @example(start=(0, 0), moves=[(2**31 - 1, -(2**31) + 1)] * 5)
    @example(start=(0, -(2**31)), moves=[(-(2**31), -(2**31))])
    def test_counts_are_the_sum_of_all_steps_across_the_32_bit_wrap(self, new_bench, start, moves):
        bench = new_bench()
        wheel, road = start
        bench.device.seize()
        bench.device.show(wheel, road)
        with bench.board:
            for wheel_sum, road_sum in zip(
                accumulate(m[0] for m in moves), accumulate(m[1] for m in moves), strict=True
            ):
                bench.device.show(wheel + wheel_sum, road + road_sum)
                sample = bench.exchange()
                assert (sample.wheel_count, sample.road_count) == (wheel_sum, road_sum)

    @pytest.mark.parametrize("wheel_sign", [1, -1])
    @pytest.mark.parametrize("road_sign", [1, -1])
    @pytest.mark.parametrize("start", [0, 2**31 - 1, -(2**31), -1])
    def test_the_wiring_gives_each_wheel_its_sign(self, new_bench, wheel_sign, road_sign, start):
        bench = new_bench(f"board.wheel_sign={wheel_sign}", f"board.road_sign={road_sign}")
        bench.device.show(start, start)
        with bench.board:
            bench.device.show(start + 70, start - 30)
            sample = bench.exchange()
            assert (sample.wheel_count, sample.road_count) == (70 * wheel_sign, -30 * road_sign)
            bench.device.show(start - 5, start + 6)
            sample = bench.exchange()
            assert (sample.wheel_count, sample.road_count) == (-5 * wheel_sign, 6 * road_sign)

    def test_the_wiring_names_the_encoder_of_each_wheel(self, new_bench):
        bench = new_bench("board.wheel_encoder=0", "board.road_encoder=1")
        bench.device.show(0, 0)
        with bench.board:
            bench.device.show(wheel=11, road=22)
            sample = bench.exchange()
        assert (sample.wheel_count, sample.road_count) == (22, 11)

    def test_a_counter_held_by_an_earlier_program_counts_again(self, new_bench):
        bench = new_bench(earlier={"encoder_reset": 0b11})
        with bench.board:
            sample = bench.roll()
        assert sample.road_count > 50
        assert sample.wheel_count > 50

    def test_counts_are_zero_where_the_wheels_were_when_the_opening_ended(self, new_bench):
        bench = new_bench()
        bench.device.plant.road_speed = bench.device.plant.wheel_speed = 100.0
        bench.link.before_operation = lambda _number: bench.clock.advance(0 if bench.settings_sent else 1_000_000)
        start = bench.device.counts()
        with bench.board:
            assert bench.device.counts() > start
            sample = bench.exchange(periods=0)
        assert (sample.wheel_count, sample.road_count) == (0, 0)
