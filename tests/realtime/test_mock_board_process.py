"""The mock board's process of a run in real time, and its reports on the faults that have acted."""

import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from inteco_abs.boards import open_board
from inteco_abs.boards.transports import links
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.signals import BoardFlags, Command

pytestmark = [pytest.mark.untraced, pytest.mark.xdist_group("real time")]

PATIENCE_S = 30.0
LONG_MS = 1000
"""Many times what a host waits for an answer."""


def stands_still(process):
    """Whether a signal has stopped it."""
    return Path(f"/proc/{process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] == "T"


@pytest.fixture
def board_with(memory, job_of, child, monkeypatch):
    """Starts the board's process with faults and a child in place of the board's holder; yields both, and the board."""
    monkeypatch.setattr(links, "PATIENCE_S", 1.0)  # its process may wait for a processor

    def start(*faults):
        job = replace(job_of(memory, "loop.rate_hz=100"), faults=faults)
        job.post(memory)
        holder = child()
        memory.words[Field.HOLDER_PID] = memory.words[Field.LOOP_PID] = holder.pid
        child(sys.executable, "-m", "inteco_abs.mock_board_process", memory.path, start_new_session=True)
        memory.wait(memory.socket.exists, PATIENCE_S)
        return holder, open_board(job.address, job.config, time.monotonic_ns)

    return start


def test_a_fault_that_has_acted_is_reported_before_the_next_exchange(memory, board_with):
    _, board = board_with("lose@drive+#1")
    with board:
        flags = [board.exchange(Command(0.1, 0.0)).board_flags for _ in range(4)]
        assert memory.note(Mailbox.INJECTED) == {"lose@drive+#1/#1": "1"}
    assert BoardFlags.STALE in flags


def test_a_pause_suspends_the_boards_owner_after_its_exchange(memory, board_with):
    holder, board = board_with(f"pause={LONG_MS}@drive")
    with board:
        board.exchange(Command(0.1, 0.0))
        assert not board.exchange(Command(0.1, 0.0)).board_flags & BoardFlags.STALE
        memory.wait(lambda: stands_still(holder), PATIENCE_S)
        assert stands_still(holder)
        memory.wait(lambda: not stands_still(holder), PATIENCE_S)
        assert not stands_still(holder)


def test_the_board_survives_a_pause_that_no_process_holds_it_for(board_with):
    holder, board = board_with("pause=1@drive")
    holder.kill()
    holder.wait()
    with board:
        assert [bool(board.exchange(Command(0.1, 0.0)).board_flags & BoardFlags.STALE) for _ in range(3)] == [False] * 3
