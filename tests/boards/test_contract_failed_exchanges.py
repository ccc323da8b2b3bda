from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.errors import LinkError
from inteco_abs.signals import BoardFlags


class TestFailedExchanges:
    def test_a_failed_exchange_gives_a_stale_sample_with_the_counts_held(self, new_bench, way):
        bench = new_bench()
        with bench.board:
            good = bench.roll()
            bench.fail_next(way)
            sample = bench.exchange(1.0)
            assert bench.link.failed == 1
            assert sample.board_flags is BoardFlags.STALE
            assert (sample.wheel_count, sample.road_count) == (good.wheel_count, good.road_count)
            assert sample.tick == good.tick + 1
            assert sample.time_ns == bench.clock.time_ns

    def test_a_failed_exchange_is_counted_and_its_cause_kept(self, new_bench, way):
        bench = new_bench()
        with bench.board as board:
            bench.exchange(1.0)
            bench.fail_next(way)
            bench.exchange(1.0)
            assert board.link_errors == 1
            assert isinstance(board.last_error, LinkError)
            assert str(board.last_error)
            bench.exchange(1.0)
            assert board.link_errors == 1

    def test_the_next_good_exchange_continues_with_the_right_counts(self, new_bench, way):
        bench = new_bench()
        road_start, wheel_start = bench.device.counts()
        with bench.board:
            before = bench.roll()
            bench.fail_next(way)
            bench.exchange(1.0)
            sample = bench.exchange(1.0)
            road, wheel = bench.device.counts()
        assert bench.link.failed == 1
        assert sample.board_flags is BoardFlags.NONE
        assert (sample.wheel_count, sample.road_count) == (wheel - wheel_start, road - road_start)
        assert sample.road_count > before.road_count

    def test_the_next_command_reaches_the_rig(self, new_bench, way):
        bench = new_bench()
        with bench.board:
            bench.exchange(1.0, 0.0)
            bench.fail_next(way)
            bench.exchange(0.8, 0.0)
            bench.exchange(0.0, 0.6)
            assert bench.link.failed == 1
            assert bench.device.duties == (0.0, 0.6)

    def test_the_first_exchange_may_fail(self, new_bench, way):
        bench = new_bench()
        with bench.board:
            bench.fail_next(way)
            first, second = bench.exchange(1.0), bench.exchange(1.0)
        assert bench.link.failed == 1
        assert (first.tick, first.board_flags, first.wheel_count, first.road_count) == (0, BoardFlags.STALE, 0, 0)
        assert (second.tick, second.board_flags) == (1, BoardFlags.NONE)

    def test_any_number_of_failures_raises_nothing(self, new_bench):
        bench = new_bench()
        with bench.board as board:
            good = bench.roll()
            bench.link.change_answer = lambda _answer: b""
            samples = [bench.exchange(1.0) for _ in range(1000)]
            bench.link.change_answer = bytes
        assert {s.board_flags for s in samples} == {BoardFlags.STALE}
        assert {(s.wheel_count, s.road_count) for s in samples} == {(good.wheel_count, good.road_count)}
        assert board.link_errors == 1000

    @given(st.data())
    def test_samples_of_any_mix_of_good_and_failed_exchanges(self, new_bench, ways_to_fail, data):
        script = data.draw(st.lists(st.none() | st.sampled_from(ways_to_fail), max_size=25))
        bench = new_bench()
        counts = held = (0, 0)
        bench.device.seize()
        bench.device.show(*counts)
        before_ns, period_ns = bench.clock.time_ns, bench.config.period_ns
        with bench.board as board:
            for tick, way in enumerate(script):
                counts = (counts[0] + 3_000, counts[1] - 2_000)
                bench.device.show(*counts)
                if way is None:
                    held = counts
                else:
                    bench.fail_next(way)
                sample = bench.exchange(0.5, 0.5)
                assert sample.tick == tick
                assert sample.board_flags is (BoardFlags.NONE if way is None else BoardFlags.STALE)
                assert (sample.wheel_count, sample.road_count) == held
                assert sample.time_ns == before_ns + period_ns
                assert sample.dt_s == period_ns / 1e9
                before_ns = sample.time_ns
                assert board.link_errors == bench.link.failed == sum(w is not None for w in script[: tick + 1])
