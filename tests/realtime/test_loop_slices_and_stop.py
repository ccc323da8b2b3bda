import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.realtime import StopFlag
from inteco_abs.signals import BoardFlags, Command, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


@pytest.fixture(scope="module")
def whole_run(new_stack):
    stack = new_stack()
    with stack.board:
        assert stack.loop().run()
    return stack.ring.reader().take()


def test_the_run_goes_through_all_phases(new_stack, whole_run):
    stack = new_stack()
    with stack.board:
        stack.loop().run()
    rows = stack.rows()
    assert rows.tobytes() == whole_run
    assert list(dict.fromkeys(rows["phase"].tolist())) == [
        Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE,
    ]  # fmt: skip
    assert set(rows["board_flags"].tolist()) == {BoardFlags.NONE}


@settings(max_examples=12)
@given(lengths=st.lists(st.integers(0, 400), min_size=1, max_size=20).filter(any))
def test_slices_give_the_same_records_as_one_run(new_stack, whole_run, lengths):
    stack, records = new_stack(), b""
    with stack.board:
        loop, over = stack.loop(), False
        while not over:
            for most in lengths:
                before = stack.ring.written
                over = loop.run(most)
                assert stack.ring.written - before <= most
                assert over or stack.ring.written - before == most
                records += stack.ring.reader().take()
                if over:
                    break
    assert records == whole_run


def test_a_slice_of_nothing_does_nothing(scripted_loop):
    run = scripted_loop([Command.SAFE] * 2)
    assert not run.loop.run(0)
    assert not run.events


def test_a_slice_that_ends_with_the_last_tick_is_over(scripted_loop):
    run = scripted_loop([Command.SAFE] * 4)
    assert not run.loop.run(3)
    assert run.loop.run(1)


def test_a_stop_word_stays_set_once_it_is_set():
    stop = StopFlag()
    assert not stop.requested
    for _ in range(2):
        stop.request()
        assert stop.requested


@pytest.mark.parametrize("phase", [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED])
def test_a_stop_ends_the_run_at_the_next_tick_with_safe_recorded(new_stack, phase):
    stack = new_stack()
    with stack.board:
        loop = stack.loop()
        rows = []
        while not rows or rows[-1]["phase"] != phase:
            assert not loop.run(1)
            rows.extend(stack.rows())
        stack.stop.request()
        assert loop.run()
        (last,) = stack.rows()
        assert last["tick"] == rows[-1]["tick"] + 1
        assert last["stop_request"]
        assert not any(row["stop_request"] for row in rows)
        assert (last["drive"], last["brake"]) == (0.0, 0.0)
        assert (last["phase"], last["reason"]) == (Phase.FAULT, Reason.OPERATOR_STOP)
    assert stack.device.duties == (0.0, 0.0)


def test_a_stop_before_the_first_tick_never_lets_an_output_on(new_stack):
    stack = new_stack()
    stack.stop.request()
    with stack.board:
        assert stack.loop().run()
        assert stack.device.duties == (0.0, 0.0)
    (row,) = stack.rows()
    assert row["stop_request"]
    assert (row["tick"], row["reason"]) == (0, Reason.OPERATOR_STOP)


def test_a_stop_that_comes_during_an_exchange_is_seen_in_the_same_tick(scripted_loop):
    run = scripted_loop([Command(0.5, 0.0)] * 6, io=lambda tick: run.stop.request() if tick == 3 else None)
    run.loop.run()
    assert [requested for _, requested, _ in run.pipeline.seen] == [False] * 3 + [True] * 3


def test_a_stop_that_comes_after_the_decision_is_seen_in_the_next_tick(scripted_loop):
    run = scripted_loop([Command(0.5, 0.0)] * 6, record=lambda tick: run.stop.request() if tick == 3 else None)
    run.loop.run()
    assert [tick.stop_request for tick in run.ticks] == [Reason.NONE] * 4 + [Reason.OPERATOR_STOP] * 2
