import pytest

from inteco_abs.errors import BoardError
from inteco_abs.signals import BoardFlags, Command, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

ON = Command(0.8, 0.6)
ERRORS = [ZeroDivisionError("in the pipeline"), KeyboardInterrupt(), SystemExit(2), MemoryError()]


def run_to_the_error(stack, pipeline, seen):
    with stack.board:
        try:
            stack.loop(pipeline).run()
        finally:
            seen.append(stack.device.duties)


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_exception_out_of_the_pipeline_leaves_safe_at_the_device(new_stack, scripted_pipeline, error):
    stack, seen = new_stack(), []
    with pytest.raises(type(error)) as caught:
        run_to_the_error(stack, scripted_pipeline([ON, ON, ON, error]), seen)
    assert caught.value is error
    assert seen == [(0.8, 0.6)]
    assert stack.device.duties == (0.0, 0.0)
    assert stack.ring.written == 3


def test_a_command_that_the_board_refuses_leaves_safe_at_the_device(new_stack, scripted_pipeline):
    stack, seen = new_stack(), []
    with pytest.raises(BoardError, match="duties"):
        run_to_the_error(stack, scripted_pipeline([ON, Command(1.5, 0.0), ON]), seen)
    assert seen == [(0.8, 0.6)]
    assert stack.device.duties == (0.0, 0.0)


def test_a_full_ring_leaves_safe_at_the_device(new_stack, scripted_pipeline):
    stack, seen = new_stack(capacity=3), []
    with pytest.raises(BufferError):
        run_to_the_error(stack, scripted_pipeline([ON] * 10), seen)
    assert seen == [(0.8, 0.6)]
    assert stack.device.duties == (0.0, 0.0)
    assert stack.rows()["tick"].tolist() == [0, 1, 2]


def test_an_exception_out_of_the_board_leaves_safe_at_the_device(new_stack, scripted_pipeline, monkeypatch):
    stack, seen = new_stack(), []
    read, calls = stack.link.read, []

    def fail_once(length):
        calls.append(length)
        if len(calls) == 9:
            raise OSError("the operating system took the device away")
        return read(length)

    monkeypatch.setattr(stack.link, "read", fail_once)
    with pytest.raises(OSError, match="took the device away"):
        run_to_the_error(stack, scripted_pipeline([ON] * 20), seen)
    assert seen == [(0.8, 0.6)]
    assert stack.device.duties == (0.0, 0.0)


def test_a_run_that_just_ends_leaves_safe_at_the_device(new_stack, scripted_pipeline):
    stack = new_stack()
    with stack.board:
        assert stack.loop(scripted_pipeline([ON] * 5)).run()
        assert stack.device.duties == (0.8, 0.6)
    assert stack.device.duties == (0.0, 0.0)


FEW_MISSES = ("guard.missed_in_a_row=4", "guard.bucket_limit=30")


def test_as_many_failed_exchanges_as_the_guard_allows_do_not_end_the_run(new_stack):
    stack = new_stack(*FEW_MISSES)
    with stack.board:
        loop = stack.loop()
        stack.link.lost = range(200, 203)
        assert loop.run()
    rows = stack.rows()
    assert stack.link.failed == stack.board.link_errors == 3
    assert rows["board_flags"].nonzero()[0].tolist() == [200, 201, 202]
    assert rows["phase"][-1] == Phase.DONE
    assert set(rows["reason"].tolist()) == {Reason.NONE}


def test_one_failed_exchange_too_many_ends_the_run_and_leaves_safe_at_the_device(new_stack):
    stack = new_stack(*FEW_MISSES)
    with stack.board:
        loop = stack.loop()
        stack.link.lost = range(200, 204)
        assert loop.run()
    rows = stack.rows()
    assert rows["board_flags"].tolist()[-4:] == [BoardFlags.STALE] * 4
    assert len(rows) == 204
    assert (rows["phase"][-1], rows["reason"][-1]) == (Phase.FAULT, Reason.MISSED_EXCHANGES)
    assert (rows["drive"][-1], rows["brake"][-1]) == (0.0, 0.0)
    assert stack.device.duties == (0.0, 0.0)


def test_a_lost_link_ends_the_run_and_names_the_emergency_switch(new_stack):
    stack, over = new_stack(*FEW_MISSES), []

    def run():
        with stack.board:
            loop = stack.loop()
            stack.link.lost = range(200, 10**9)
            over.append(loop.run())

    with pytest.raises(BoardError, match="emergency switch"):
        run()
    assert over == [True]
    assert stack.rows()["reason"][-1] == Reason.MISSED_EXCHANGES


def test_failed_exchanges_do_not_shift_the_counts_that_follow(new_stack):
    stack = new_stack("guard.missed_in_a_row=100", "guard.bucket_limit=3000")
    start_road, start_wheel = stack.device.counts()
    with stack.board:
        loop = stack.loop()
        stack.link.lost = set(range(100, 900, 7))
        assert not loop.run(900)
        road, wheel = stack.device.counts()
    last = stack.rows()[-1]
    assert stack.link.failed > 100
    assert last["board_flags"] == BoardFlags.NONE
    assert (last["road_count"], last["wheel_count"]) == (road - start_road, wheel - start_wheel)
