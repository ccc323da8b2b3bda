"""The guardian in a thread of the test, a mock board in another, and real processes that die."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import FRAME_BYTES, HEADER_BYTES, READ_REQUEST, encode_send
from inteco_abs.boards import SocketLink
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError
from inteco_abs.mock_board import Device, SocketServer
from inteco_abs.realtime import process_watch as watch_module
from inteco_abs.realtime.failure_rules import Silence
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.realtime.processes import guardian as guardian_module
from inteco_abs.realtime.processes.guardian import Guardian, rescue
from inteco_abs.realtime.tuning import guardian_tuning
from inteco_abs.sessions import TICK
from inteco_abs.signals import Reason

PINS = {"pin_mode": 1 << 2 | 1 << 5, "pin_direction": 0}
DRIVING = encode_send({**PINS, "pwm0_width": 200, "pwm1_width": 100})
SAFE = encode_send(PINS)


def header_of_the_mock():
    """What each of its answers begins with."""
    front_end = Usb2FrontEnd(Device(load_config(), lambda: 0))
    front_end.bulk_out(READ_REQUEST)
    return front_end.bulk_in(FRAME_BYTES)[:HEADER_BYTES]


IMAGE = header_of_the_mock() + SAFE


def unnumbered(frame):
    """A frame without the number that it carries."""
    return frame[:82] + b"\0\0" + frame[84:]


BOTH = (200 / 255, 100 / 255)
OFF = (0.0, 0.0)
AS_ON_A_REAL_BOARD = "guard.silence_s=0.05"
SLOW = (AS_ON_A_REAL_BOARD, "loop.rate_hz=50.0", "estimator.window_s=0.1")
POLL_NS = 5_000_000
WINDOW_NS = 50_000_000
MOST_AWAKE_NS = 2 * POLL_NS


class TestSilence:
    @given(st.lists(st.tuples(st.integers(1, 1000), st.integers(0, 10**12)), max_size=100))
    def test_a_count_that_moves_is_never_silent(self, steps):
        silence, count = Silence(WINDOW_NS), 0
        for more, passed_ns in steps:
            count += more
            assert not silence.lasts(count, passed_ns)

    @given(
        polls_ns=st.lists(st.integers(1_000_000, MOST_AWAKE_NS), min_size=60, max_size=60),
        window_ns=st.integers(0, WINDOW_NS),
        count=st.integers(0, 2**40),
    )
    def test_a_count_that_does_not_change_is_silent_once_the_window_has_passed(self, polls_ns, window_ns, count):
        silence, passed_ns = Silence(window_ns), 0
        silence.lasts(count, 0)
        for poll_ns in polls_ns:
            passed_ns += poll_ns
            assert silence.lasts(count, poll_ns) == (passed_ns > window_ns)

    @given(
        stall_ns=st.integers(0, 10**13),
        before=st.integers(0, WINDOW_NS // POLL_NS - 2),
        again=st.booleans(),
    )
    def test_a_stall_of_the_whole_computer_uses_up_two_polls_at_most(self, stall_ns, before, again):
        silence = Silence(WINDOW_NS)
        silence.lasts(7, 0)
        for _ in range(before):
            assert not silence.lasts(7, POLL_NS)
        assert not silence.lasts(7, stall_ns)
        if again:
            assert not silence.lasts(8, POLL_NS)
        polls = 1
        while not silence.lasts(7 + again, POLL_NS):
            polls += 1
        assert polls >= WINDOW_NS // POLL_NS - 2 - (0 if again else before)

    @given(st.lists(st.one_of(st.just("moves"), st.just("forgotten"), st.integers(1, 9)), max_size=60))
    def test_silence_never_lasts_while_counts_move_or_it_is_reset(self, script):
        silence, count = Silence(WINDOW_NS), 0
        for step in script:
            if step == "moves":
                count += 1
                assert not silence.lasts(count, POLL_NS)
            elif step == "forgotten":
                silence.forget()
            else:
                silence.forget()
                assert not any(silence.lasts(count, POLL_NS) for _ in range(step))

    def test_a_new_count_ends_the_silence(self):
        silence = Silence(WINDOW_NS)
        assert [silence.lasts(1, POLL_NS) for _ in range(20)].count(True) > 0
        assert not silence.lasts(2, POLL_NS)


class NotedFace(Usb2FrontEnd):
    """The mock's endpoints, and everything that the host has written to them."""

    def __init__(self, device):
        super().__init__(device)
        self.written = []

    def bulk_out(self, data):
        self.written.append(bytes(data))
        super().bulk_out(data)


class Run:
    """What a supervisor makes of a run's memory, with the test in its place; the guardian is a thread."""

    def __init__(self, memory, job, until):
        self.memory, self.job, self.words = memory, job, memory.words
        self._until = until
        self.device = Device(job.config, time.monotonic_ns, 1)
        self.front_end = NotedFace(self.device)
        self.server = SocketServer(self.front_end, str(memory.socket))
        self.pool = ThreadPoolExecutor(2)
        self.stopping = threading.Event()
        self.words[Field.SUPERVISOR_PID] = os.getpid()
        self.words[Field.SUPERVISOR_BEAT_NS] = 1
        self.serving = self.pool.submit(self._serve)
        self.watching = self.pool.submit(Guardian(memory, job).watch)

    def _serve(self):
        while not self.stopping.is_set():
            self.server.step()

    def close(self):
        self.words[Field.OVER] = 1
        try:
            self.watching.result(30)
        finally:
            self.stopping.set()
            self.serving.result(30)
            self.server.close()
            self.pool.shutdown()

    def until(self, condition, what=""):
        """Wait as a supervisor waits, with a heartbeat."""

        def beating():
            self.words[Field.SUPERVISOR_BEAT_NS] += 1
            return condition()

        self._until(beating, what)

    def leave_driving(self):
        """What the process that holds the board has written to it."""
        self.until(lambda: not self.server.busy, "the board is free")
        link = SocketLink(str(self.memory.socket))
        link.write(DRIVING)
        self.until(lambda: self.device.duties == BOTH, "the outputs are on")
        link.close()
        self.until(lambda: not self.server.busy, "the board is free again")
        self.front_end.written.clear()

    def host(self):
        """A connection to the board, as a socket."""
        self.until(lambda: not self.server.busy, "the board is free")
        host = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        host.connect(str(self.memory.socket))
        assert host.recv(100)
        return host

    def guard(self, pid):
        self.words[Field.GUARDED_PID] = pid
        self.until(lambda: self.words[Field.GUARDING_PID] == pid, "it is guarded")

    def hold(self, pid):
        """The guarded process has the board and has written to it."""
        self.leave_driving()
        self.memory.post(Mailbox.SAFE_IMAGE, IMAGE)
        self.words[Field.HOLDER_PID] = pid
        self.guard(pid)

    def until_rescued(self, pid):
        self.until(lambda: self.words[Field.RESCUED_PID] == pid, "the board is taken over")
        return self.memory.note(Mailbox.RESCUE)

    def until_polled(self, times=3):
        """The guardian has looked around that often."""
        for _ in range(times):
            before = self.words[Field.GUARDIAN_BEAT_NS]
            self.until(lambda before=before: self.words[Field.GUARDIAN_BEAT_NS] != before, "the guardian polls")


@pytest.fixture
def new_run(memory, job_of, until):
    """Makes the one run of a test."""
    with ExitStack() as stack:

        def make(*settings):
            run = Run(memory, job_of(memory, *settings), until)
            stack.callback(run.close)
            return run

        yield make


@pytest.fixture
def run(new_run):
    return new_run(AS_ON_A_REAL_BOARD)


def tick(buffer, offset, number):
    TICK.pack_into(buffer, offset, [number] * len(TICK.columns))


class TestDeath:
    @pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
    def test_the_board_of_a_dead_process_is_made_safe_and_that_is_reported(self, run, child, number):
        process = child()
        run.hold(process.pid)
        before_ns = time.monotonic_ns()
        process.send_signal(number)
        report = run.until_rescued(process.pid)
        assert run.device.duties == OFF
        assert (report["cause"], report["failure"]) == ("died", "")
        assert before_ns <= report["seen_ns"] <= report["done_ns"] <= time.monotonic_ns()

    def test_the_first_thing_that_it_writes_is_the_image_that_was_left(self, run, child):
        process = child()
        run.hold(process.pid)
        process.kill()
        run.until_rescued(process.pid)
        assert unnumbered(run.front_end.written[0]) == SAFE
        assert DRIVING not in run.front_end.written

    def test_the_board_of_a_dead_process_is_taken_once_the_kernel_releases_it(self, run, child):
        run.leave_driving()
        host = run.host()
        process = child("sleep", "600", pass_fds=[host.fileno()])
        host.close()
        run.memory.post(Mailbox.SAFE_IMAGE, IMAGE)
        run.words[Field.HOLDER_PID] = process.pid
        run.guard(process.pid)
        with pytest.raises(BoardError, match="another host"):
            SocketLink(str(run.memory.socket))
        process.kill()
        assert run.until_rescued(process.pid)["failure"] == ""
        assert run.device.duties == OFF

    def test_a_board_that_another_host_still_has_is_tried_again(self, run, child):
        process = child()
        run.hold(process.pid)
        host = run.host()
        process.kill()
        time.sleep(0.1)
        assert run.words[Field.RESCUED_PID] == 0
        assert run.device.duties == BOTH
        host.close()
        assert run.until_rescued(process.pid)["failure"] == ""
        assert run.device.duties == OFF

    def test_guardian_reports_a_board_it_cannot_make_safe_and_continues(self, run, child, monkeypatch):
        first, second = child(), child()
        run.hold(first.pid)
        host = run.host()
        with monkeypatch.context() as patch:
            patch.setattr(guardian_module, "_TRY_S", 0.05)
            first.kill()
            assert "another host" in run.until_rescued(first.pid)["failure"]
        assert run.device.duties == BOTH
        host.close()
        run.hold(second.pid)
        second.kill()
        assert run.until_rescued(second.pid)["failure"] == ""
        assert run.device.duties == OFF

    def test_its_heartbeat_continues_while_it_tries(self, run, child):
        process = child()
        run.hold(process.pid)
        with run.host():
            process.kill()
            process.wait()
            run.until_polled(5)
            assert run.words[Field.RESCUED_PID] == 0
        run.until_rescued(process.pid)

    def test_process_that_released_the_board_does_not_count_as_its_holder(self, run, child):
        process = child()
        run.hold(process.pid)
        run.words[Field.HOLDER_PID] = 0
        process.kill()
        run.until_polled(5)
        assert run.front_end.written == []
        assert run.memory.note(Mailbox.RESCUE) is None
        assert run.words[Field.RESCUED_PID] == 0
        assert run.device.duties == BOTH

    def test_without_an_image_nothing_is_written_as_nothing_was_before(self, run, child):
        process = child()
        run.leave_driving()
        run.words[Field.HOLDER_PID] = process.pid
        run.guard(process.pid)
        process.kill()
        assert run.until_rescued(process.pid)["failure"] == ""
        assert run.front_end.written == []

    def test_process_dead_before_the_first_look_has_its_board_made_safe(self, run, child):
        process = child()
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        run.hold(process.pid)
        run.until_rescued(process.pid)
        assert run.device.duties == OFF

    def test_a_number_without_a_process_does_not_end_it(self, run, child, ended):
        run.words[Field.GUARDED_PID] = ended
        run.until_polled(5)
        assert run.words[Field.GUARDING_PID] == 0
        run.guard(child().pid)

    def test_no_descriptor_of_a_dead_process_stays_open(self, run, child, monkeypatch):
        opened, pidfd_open = set(), os.pidfd_open

        def noted(pid):
            opened.add(descriptor := pidfd_open(pid))
            return descriptor

        monkeypatch.setattr(os, "pidfd_open", noted)
        process = child()
        run.guard(process.pid)
        process.kill()
        process.wait()
        run.guard(child().pid)
        first = set(opened)
        run.words[Field.OVER] = 1
        run.watching.result(30)
        left = []
        for descriptor in first:
            with suppress(OSError):
                left.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        assert len([each for each in left if "pidfd" in each]) <= 1  # of the second one

    def test_its_watchers_wait_longer_than_it_tries(self):
        assert guardian_module._TRY_S < watch_module._RESCUE_NS * 1e-9

    @pytest.mark.untraced
    def test_after_one_rescue_it_guards_the_next_process(self, run, child):
        for _ in range(3):
            process = child()
            run.hold(process.pid)
            process.kill()
            run.until_rescued(process.pid)
            assert run.device.duties == OFF
            assert run.words[Field.GUARDING_PID] == process.pid


def test_a_supervisor_that_dies_before_the_guardian_starts_ends_the_run(memory, job_of, ended):
    memory.words[Field.SUPERVISOR_PID] = ended
    Guardian(memory, job_of(memory)).watch()
    assert memory.words[Field.GUARDIAN_STOP] == Reason.SUPERVISOR_LOST


class TestRescue:
    def test_a_board_that_is_not_there_is_a_board_error(self, memory, job_of):
        memory.post(Mailbox.SAFE_IMAGE, IMAGE)
        with pytest.raises(BoardError, match="no board"):
            rescue(memory, job_of(memory))

    def test_no_time_is_spent_on_which_way_to_move_transfers_is_quicker(self, memory, job_of, monkeypatch):
        chosen = []

        def open_board(_address, config, _now_ns):
            chosen.append(config.usb.engine)
            raise BoardError("this is all that the test wants to know")

        monkeypatch.setattr(guardian_module, "open_board", open_board)
        memory.post(Mailbox.SAFE_IMAGE, IMAGE)
        with pytest.raises(BoardError, match="all that"):
            rescue(memory, job_of(memory, "usb.engine=faster"))
        assert chosen == ["one-by-one"]

    def test_the_board_is_free_afterwards(self, run):
        run.leave_driving()
        run.memory.post(Mailbox.SAFE_IMAGE, IMAGE)

        def rescued():
            with suppress(BoardError):  # on a busy computer the board's thread may be late
                rescue(run.memory, run.job)
                return True

        def taken():
            with suppress(BoardError):  # the board sees a little later that its host has left
                run.host().close()
                return True

        run.until(rescued, "it is rescued")
        assert run.device.duties == OFF
        run.until(taken, "it is free")


def test_the_process_guards_and_ends_when_all_is_over(memory, job_of, child, until):
    job_of(memory)
    memory.words[Field.SUPERVISOR_PID] = os.getpid()
    process = child(
        sys.executable, "-m", "inteco_abs.realtime.processes", "guardian", memory.path, stderr=subprocess.PIPE
    )
    memory.words[Field.GUARDED_PID] = child().pid
    until(lambda: memory.words[Field.GUARDING_PID], "it guards")
    memory.words[Field.OVER] = 1
    assert process.wait(30) == 0
    assert process.communicate()[1] == b""


def test_the_process_prepares_itself_and_then_watches_until_nothing_is_left(memory, job_of, ended, monkeypatch):
    tunings, done = guardian_tuning(), []
    monkeypatch.setattr(guardian_module, "guardian_tuning", lambda: tunings)
    monkeypatch.setattr(guardian_module, "apply", done.append)
    job_of(memory)
    memory.words[Field.SUPERVISOR_PID] = ended
    assert guardian_module.main(str(memory.path)) == 0
    assert done == [tunings]
    assert memory.words[Field.GUARDIAN_STOP] == Reason.SUPERVISOR_LOST


def standing_of(pid):
    """What the kernel grants a process: its scheduler, its priority, and whether its memory is locked."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    locked = int(status.partition("VmLck:")[2].split()[0]) > 0
    return os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(pid).sched_priority, locked


PREPARED = """
from inteco_abs.realtime.tuning import guardian_tuning, apply
apply(guardian_tuning())
print("prepared", flush=True)
input()
"""


@pytest.mark.untraced
def test_the_process_has_the_priority_and_locked_memory_granted_here(memory, job_of, child, python_child, until):
    job_of(memory)
    memory.words[Field.SUPERVISOR_PID] = os.getpid()
    like = python_child(PREPARED, stdin=subprocess.PIPE)
    assert like.stdout.readline() == "prepared\n"
    if standing_of(like.pid) == standing_of(os.getpid()):
        pytest.skip("this computer grants neither a real-time priority nor locked memory")
    process = child(sys.executable, "-m", "inteco_abs.realtime.processes", "guardian", memory.path)
    until(lambda: memory.words[Field.GUARDIAN_BEAT_NS], "it watches")
    assert standing_of(process.pid) == standing_of(like.pid)
