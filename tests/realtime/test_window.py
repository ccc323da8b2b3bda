"""The newest part of a run, as it comes and when it is over."""

import pytest

from inteco_abs.realtime.window import Window
from inteco_abs.sessions import TICK, TRUTH, pack_tick
from inteco_abs.sessions.failover_writer import joined

PER_TICK = 2
"""States of the rig for each tick."""


class Run:
    """A run whose states come before the ticks that see them; times are numbers."""

    def __init__(self, memory, before=0):
        self._ticks, self._truths = memory.tick_ring(pack_tick), memory.truth_ring(TRUTH.pack_into)
        self.states(before)
        self.window = Window(memory.tick_reader(), memory.truth_reader())

    def states(self, count):
        for _ in range(count):
            time_ns = self._truths.written
            self._truths.append([time_ns if column.name == "time_ns" else 0 for column in TRUTH.columns])

    def ticks(self, count):
        for _ in range(count):
            self.states(PER_TICK)
            now = {"tick": self._ticks.written, "time_ns": self._truths.written}
            self._ticks.append([now.get(column.name, 0) for column in TICK.columns])


def numbers(blocks):
    """Numbers of ticks, and of states, in what a window gives."""
    blocks = list(blocks)
    ticks, truths = (
        message.array(b"".join(part)) for message, part in zip((TICK, TRUTH), zip(*blocks, strict=True), strict=True)
    )
    return ticks["tick"].tolist(), truths["time_ns"].tolist()


@pytest.fixture
def run(new_memory):
    return Run(new_memory(16000, 34000), before=7)


def test_what_came_is_handed_over_once_and_stays_after_it_is_in_a_file(run):
    run.window.skip_truths()
    run.ticks(5)
    first = run.window.more(last=True)
    run.ticks(2)
    assert (numbers([first])[0], numbers([run.window.more(last=True)])[0]) == ([0, 1, 2, 3, 4], [5, 6])
    assert run.window.waiting == 7
    run.window.release(6)  # of the second two, not all are on the disk yet
    assert run.window.waiting == 2
    run.window.release(7)
    assert run.window.waiting == 0
    run.ticks(1)  # which `more` has not returned
    assert numbers(run.window.held()) == (list(range(7)), list(range(7, 7 + 7 * PER_TICK)))


def test_a_tick_never_comes_before_a_state_that_it_has_seen(run):
    run.ticks(10_000)
    run.window.more(last=True)
    blocks, newest_ns = list(run.window.held()), 0
    assert len(blocks) > 2
    for ticks, truths in blocks:
        newest_ns = int(TRUTH.array(truths)["time_ns"].max(initial=newest_ns))
        assert newest_ns >= TICK.array(ticks)["time_ns"].max(initial=0) - 1
    assert numbers(blocks) == (list(range(10_000)), list(range(7 + 10_000 * PER_TICK)))


def test_a_wrapped_ring_returns_only_rows_the_loop_cannot_overwrite(new_memory):
    memory = new_memory(800, 1700)
    run = Run(memory)
    for _ in range(3):
        run.ticks(500)
        run.window.more(last=True)
        run.window.release(run.window.end)
    assert numbers(run.window.held())[0] == list(range(800, 1500))
    over = Window(memory.tick_reader(), memory.truth_reader(), over=True)
    assert numbers(over.held())[0] == list(range(700, 1500))


def test_what_no_file_has_is_held_to_the_last_tick_that_comes_in(new_memory):
    memory = new_memory(800, 1700)
    run = Run(memory)
    run.ticks(100)
    run.window.more(last=True)
    run.window.release(run.window.end)
    run.ticks(800)
    run.window.more(last=True)
    assert run.window.room == 0
    assert numbers(run.window.held())[0] == list(range(100, 900))


def test_what_a_file_has_may_go_from_memory_while_the_file_is_read(run):
    """The loop continues meanwhile: each tick comes once, from the file or from memory."""
    run.ticks(300)
    records = [run.window._ticks.look(number, 1)[0] for number in range(300)]
    looks = iter([range(100, 200), range(190, 300)])
    blocks = joined(
        lambda: [(b"".join(records[:195]), b"")], lambda: [(b"".join(records[n] for n in next(looks)), b"")]
    )
    assert TICK.array(b"".join(ticks for ticks, _ in blocks))["tick"].tolist() == list(range(300))
