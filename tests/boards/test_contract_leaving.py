import itertools
from contextlib import suppress

import pytest

from inteco_abs.errors import LinkError, UnsafeError

WAYS_OUT = (None, ValueError("in the body"), KeyboardInterrupt(), SystemExit(3), GeneratorExit())
FAULTS = (LinkError("no answer"), KeyboardInterrupt())
PAIRS = [
    pytest.param(*pair, marks=() if pair == (FAULTS[0], FAULTS[0]) else pytest.mark.long)
    for pair in itertools.product(FAULTS, repeat=2)
]
MOMENTS = 40
"""More than a short session has, but for that of single accesses to registers."""


def live(bench, way_out):
    with bench.board:
        bench.exchange(1.0, 0.6)
        assert bench.device.duties == (1.0, 0.6)
        if way_out is not None:
            raise way_out


def ignored_at_the_end(bench, drive, brake):
    with bench.board:
        bench.exchange(drive, brake)
        bench.ignore_commands()


def assert_safe_and_closed(bench):
    assert bench.device.duties == (0.0, 0.0)
    assert bench.device.settings["pwm0_width"] == bench.device.settings["pwm1_width"] == 0
    assert bench.link.closed


class TestLeaving:
    def test_a_normal_exit_leaves_safe_behind(self, new_bench):
        bench = new_bench()
        live(bench, None)
        assert_safe_and_closed(bench)

    @pytest.mark.parametrize("way_out", WAYS_OUT[1:], ids=lambda error: type(error).__name__)
    def test_an_exception_leaves_safe_behind_and_passes_on(self, new_bench, way_out):
        bench = new_bench()
        with pytest.raises(type(way_out)) as caught:
            live(bench, way_out)
        assert caught.value is way_out
        assert_safe_and_closed(bench)

    def test_closing_a_generator_leaves_safe_behind(self, new_bench):
        bench = new_bench()

        def session():
            with bench.board:
                while True:
                    yield bench.exchange(1.0, 0.6)

        run = session()
        next(run)
        assert bench.device.duties == (1.0, 0.6)
        run.close()
        assert_safe_and_closed(bench)

    def test_safe_is_read_back_before_the_board_is_released(self, new_bench):
        bench = new_bench()
        live(bench, None)
        assert bench.acts[-2:] == ["send", "read"]

    def test_safe_can_be_requested_at_any_time_and_the_run_can_continue(self, new_bench):
        bench = new_bench()
        with bench.board:
            bench.exchange(1.0, 0.6)
            bench.board.make_safe()
            assert bench.device.duties == (0.0, 0.0)
            assert bench.exchange(0.4, 0.0).tick == 1
            assert bench.device.duties == (0.4, 0.0)

    def test_safe_after_an_exchange_that_failed(self, new_bench, way):
        bench = new_bench()
        with bench.board:
            bench.exchange(1.0, 0.6)
            bench.fail_next(way)
            bench.exchange(1.0, 0.8)
        assert bench.link.failed == 1
        assert_safe_and_closed(bench)

    def test_safe_that_is_not_confirmed_at_once_is_tried_again(self, new_bench, way):
        bench = new_bench()
        with bench.board:
            bench.exchange(1.0, 0.6)
            bench.fail_next(way)
        assert bench.link.failed == 1
        assert_safe_and_closed(bench)

    @pytest.mark.parametrize(("failures", "confirmed"), [(1, True), (2, True), (3, False)])
    def test_safe_is_tried_three_times(self, new_bench, failures, confirmed):
        bench, lost = new_bench(), []

        def lose(_answer):
            lost.append(len(lost))
            return b"" if len(lost) <= failures else _answer

        with bench.board:
            bench.exchange(1.0, 0.6)
            bench.link.change_answer = lose
            if confirmed:
                bench.board.make_safe()
            else:
                with pytest.raises(UnsafeError, match="emergency switch"):
                    bench.board.make_safe()
            assert len(lost) == min(failures + 1, 3)

    @pytest.mark.parametrize("way_out", WAYS_OUT, ids=lambda error: type(error).__name__)
    def test_a_lost_link_is_an_error_that_names_the_emergency_switch(self, new_bench, way_out):
        bench = new_bench()
        bench.link.before_operation = lambda _number: bench.unplug() if bench.device.duties == (1.0, 0.6) else None
        with pytest.raises(UnsafeError, match=r"SAFE could not be confirmed.*unplugged.*emergency switch") as caught:
            live(bench, way_out)
        assert isinstance(caught.value.__cause__, LinkError)
        assert bench.link.failed
        assert bench.link.closed
        assert bench.device.duties == (1.0, 0.6)

    def test_a_board_that_ignores_commands_is_an_error_that_names_the_emergency_switch(self, new_bench):
        bench = new_bench()
        with pytest.raises(UnsafeError, match=r"SAFE could not be confirmed.*emergency switch"):
            ignored_at_the_end(bench, 1.0, 0.6)
        assert bench.front_end.ignored == 3 * bench.sends_of_safe
        assert bench.link.closed
        assert bench.device.duties == (1.0, 0.6)

    def test_leaving_counts_safe_as_confirmed_only_if_the_board_echoes_it(self, new_bench):
        bench = new_bench()
        with pytest.raises(UnsafeError, match="emergency switch"):
            ignored_at_the_end(bench, 0.0, 1 / 255)
        assert bench.device.settings["pwm1_width"] == 1

    @pytest.mark.parametrize("error", FAULTS, ids=lambda error: type(error).__name__)
    def test_one_fault_at_any_moment_never_leaves_an_output_on(self, new_bench, error):
        moments = 0
        while struck(bench := new_bench(), {moments: error}):
            assert bench.device.duties == (0.0, 0.0), moments
            moments += 1
        assert moments > 12

    @pytest.mark.long
    @pytest.mark.parametrize(("first", "second"), PAIRS, ids=lambda error: type(error).__name__)
    def test_two_faults_at_any_two_moments_never_leave_an_output_on(self, new_bench, first, second):
        pairs = 0
        for one in range(MOMENTS):
            for other in range(one + 1, MOMENTS):
                bench = new_bench()
                reached = struck(bench, {one: first, other: second})
                assert bench.device.duties == (0.0, 0.0), (one, other)
                if reached != [one, other]:
                    break  # nor would a second fault that is later still be come to
                pairs += 1
        assert pairs > 12

    def test_an_interrupt_while_safe_is_written_is_raised_once_it_is_confirmed(self, new_bench):
        bench, interrupt = new_bench(), KeyboardInterrupt()
        with pytest.raises(KeyboardInterrupt) as caught:
            interrupted_at_the_end(bench, interrupt)
        assert caught.value is interrupt
        assert_safe_and_closed(bench)


def interrupted_at_the_end(bench, interrupt):
    with bench.board:
        bench.exchange(1.0, 0.6)
        bench.strike({bench.link.operations: interrupt})


def struck(bench, errors):
    """Live shortly with `errors` at these uses of the link; those that it came to."""
    bench.device.seize()
    reached = bench.strike(errors)
    with suppress(LinkError, KeyboardInterrupt), bench.board:
        for _ in range(3):
            bench.exchange(1.0, 0.6)
    return reached
