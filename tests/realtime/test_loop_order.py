from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.signals import Command

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

commands = st.builds(Command, st.floats(0.0, 1.0), st.floats(0.0, 1.0))


@given(script=st.lists(commands, min_size=1, max_size=30))
def test_a_tick_writes_the_command_of_the_tick_before_and_the_first_writes_safe(scripted_loop, script):
    run = scripted_loop(script)
    assert run.loop.run()
    assert run.board.commands == [Command.SAFE, *script[:-1]]


@given(
    script=st.lists(commands, min_size=1, max_size=30), lengths=st.lists(st.integers(0, 7), min_size=40, max_size=40)
)
def test_so_it_does_when_it_runs_in_slices(scripted_loop, script, lengths):
    run = scripted_loop(script)
    for most in lengths:
        if run.loop.run(most):
            break
    else:
        run.loop.run()
    assert run.board.commands == [Command.SAFE, *script[:-1]]


def test_within_a_tick_output_and_input_come_first_then_decision_then_record(scripted_loop):
    run = scripted_loop([Command(0.1, 0.2)] * 3)
    run.loop.run()
    assert run.events == [(event, tick) for tick in range(3) for event in ("exchange", "decide", "record")]


def test_the_sample_of_a_tick_is_what_it_decides_on_and_records(scripted_loop):
    run = scripted_loop([Command(0.1, 0.2)] * 5)
    run.loop.run()
    assert [sample.tick for sample, _, _ in run.pipeline.seen] == [0, 1, 2, 3, 4]
    assert [tick.tick for tick in run.ticks] == [0, 1, 2, 3, 4]
    assert [tick.time_ns for tick in run.ticks] == [500_000, 1_000_000, 1_500_000, 2_000_000, 2_500_000]


def test_the_last_tick_is_the_one_that_finished(scripted_loop):
    run = scripted_loop([Command(0.1, 0.2)] * 4)
    assert run.loop.run(100)
    assert len(run.ticks) == 4


def test_on_the_real_stack_the_rig_gets_what_was_recorded_one_tick_earlier(new_stack):
    stack = new_stack()
    with stack.board:
        loop, duties = stack.loop(), []
        while not loop.run(1):
            duties.append(stack.device.duties)
        duties.append(stack.device.duties)
    rows = stack.rows()
    full = 255
    wanted = [(row["drive"] * full, row["brake"] * full) for row in rows]
    assert duties[0] == (0.0, 0.0)
    assert max(drive for drive, _ in duties) == 0.8
    assert max(brake for _, brake in duties) > 0.4
    for (drive, brake), (_, output) in zip(wanted, pairwise(duties), strict=False):
        assert drive - 1.0 < output[0] * full <= drive + 1e-6
        assert brake - 1.0 < output[1] * full <= brake + 1e-6


@pytest.mark.parametrize("steps", [1, 2, 10])
def test_a_command_that_changes_every_tick_arrives_one_tick_late(scripted_loop, steps):
    script = [Command(tick % 2, 1.0 - tick % 2) for tick in range(steps)]
    run = scripted_loop(script)
    run.loop.run()
    assert [tick.drive for tick in run.ticks] == [command.drive for command in script]
    assert run.board.commands[1:] == script[:-1]
