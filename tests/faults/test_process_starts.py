"""A run in real time whose k-th process, or whose thread, cannot be started."""

import errno
import os
import subprocess
import threading

import pytest

from inteco_abs.config import load_config
from inteco_abs.errors import BoardError
from inteco_abs.experiment import Plan, manual_control, run_stop
from inteco_abs.realtime import memory
from inteco_abs.realtime.heartbeat import beating
from inteco_abs.sessions import TICK, TRUTH
from tests.faults.stage import SHORTEST

pytestmark = [pytest.mark.untraced, pytest.mark.xdist_group("real time")]

ROLES = ("board", "guardian", "recorder", "drill", "loop")
MODULES = {"inteco_abs.mock_board_process", "inteco_abs.realtime.processes"}


def assert_nothing_is_left_on(memories, left_processes):
    truths = TRUTH.array(memories[-1].truth_reader().look(0)[0])
    assert not truths["drive"].any()
    assert not truths["brake"].any()
    assert left_processes() == []
    assert list(memory.FOLDER.iterdir()) == []


def refuse(monkeypatch, k):
    """Let the k-th process of ours not be started."""
    start, begun = subprocess.Popen._execute_child, []

    def attempt(self, words, *arguments):
        if not MODULES.isdisjoint(words):
            begun.append(words)
            if len(begun) == k + 1:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        return start(self, words, *arguments)

    monkeypatch.setattr(subprocess.Popen, "_execute_child", attempt)


@pytest.mark.parametrize(
    "role", [pytest.param(role, marks=[] if role in {"board", "guardian"} else pytest.mark.long) for role in ROLES]
)
def test_a_process_that_cannot_be_started_is_named_and_nothing_is_started(
    monkeypatch, tmp_path, memories, left_processes, role
):
    refuse(monkeypatch, ROLES.index(role))
    with pytest.raises(BoardError, match=f"the {role} process cannot be started: {os.strerror(errno.EAGAIN)}"):
        run_stop(load_config(settings=SHORTEST), Plan(tmp_path / "stop.mcap", virtual=False))
    assert list(tmp_path.iterdir()) == []
    assert_nothing_is_left_on(memories, left_processes)


@pytest.fixture
def no_threads(monkeypatch):
    def refuse_threads(_self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse_threads)


@pytest.mark.usefixtures("no_threads")
def test_a_thread_that_cannot_be_started_is_an_error_of_ours(memories):
    made = memory.RunMemory.create(TICK.size, 1, TRUTH.size, 1)
    with pytest.raises(BoardError, match="no thread can be started"), beating(made, memory.Field.RECORDER_BEAT_NS, 0.1):
        pytest.fail("it was entered")
    memories[-1].remove()


@pytest.mark.long
@pytest.mark.usefixtures("no_threads")
def test_a_panel_whose_thread_cannot_be_started_leaves_outputs_off_and_says_so(memories, left_processes):
    with (
        pytest.raises(BoardError, match="no thread can be started"),
        manual_control(load_config(), "sim:", outputs=False),
    ):
        pytest.fail("it was entered")
    assert_nothing_is_left_on(memories, left_processes)
