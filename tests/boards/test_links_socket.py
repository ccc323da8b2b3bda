"""Two processes on one computer, with the board's one played by a thread."""

import gc
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from firmware_protocol.local_socket import GREETING
from firmware_protocol.rtdac_usb2 import FRAME_BYTES, READ_REQUEST, decode_read, encode_send
from inteco_abs.boards import SocketLink, open_board
from inteco_abs.boards import frame_board as frames
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.boards.transports import links
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError, LinkError
from inteco_abs.mock_board import Device, SocketServer
from inteco_abs.signals import Command

PATIENCE_S = 30.0
BOTH = (1.0, 0.6)
OFF = (0.0, 0.0)

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="sockets of this kind are Linux's")


def until(condition, what):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"it never came to that: {what}"
        time.sleep(0.001)


@pytest.fixture
def path():
    """A name short enough for a socket."""
    with tempfile.TemporaryDirectory(prefix="abs-") as folder:
        yield str(Path(folder) / "board")


class Served:
    """A mock board that listens at `path`, served by a thread."""

    def __init__(self, path):
        self.config = load_config()
        self.device = Device(self.config, time.monotonic_ns, 1)
        self.front_end = Usb2FrontEnd(self.device)
        self.server = SocketServer(self.front_end, path)
        self.path = path
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self):
        while not self._stopping.is_set():
            self.server.step()

    def stop(self):
        """The board's process is gone."""
        self._stopping.set()
        self._thread.join()
        self.server.close()

    def link(self):
        """A host that has the board; those before it have left, which the board may not have seen yet."""
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                return SocketLink(self.path)
            except BoardError:
                assert time.monotonic() < end

    def drive(self, link):
        """Both outputs on, as the host behind `link`."""
        pins = {"pin_mode": 1 << 2 | 1 << 5, "pin_direction": 0}
        link.write(encode_send({**pins, "pwm0_width": 255, "pwm1_width": 153}))
        until(lambda: self.device.duties == BOTH, "the outputs are on")


@pytest.fixture
def served(path):
    board = Served(path)
    yield board
    board.stop()


@pytest.fixture
def link(served):
    made = served.link()
    yield made
    made.close()


class Scripted:
    """A board's socket that sends `greeting` to one host, and nothing else."""

    def __init__(self, path, greeting):
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.listener.bind(path)
        self.listener.listen()
        self._greeting = greeting
        self.host = None
        self._thread = threading.Thread(target=self._welcome)
        self._thread.start()

    def _welcome(self):
        self.host, _ = self.listener.accept()
        if self._greeting:
            self.host.send(self._greeting)

    def welcomed(self):
        """The board's end of the connection."""
        self._thread.join()
        return self.host

    def close(self):
        self.welcomed().close()
        self.listener.close()


@pytest.fixture
def mute(path):
    """A link to a board that greets and never answers; and that board's end."""
    board = Scripted(path, GREETING)
    link = SocketLink(path)
    yield link, board.welcomed()
    link.close()
    board.close()


def answer_of(link):
    """The next answer of a board that may be late, as a busy computer's is."""
    link.write(READ_REQUEST)
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            return link.read(FRAME_BYTES)
        except LinkError:
            assert time.monotonic() < end


class TestOpening:
    def test_a_host_that_is_greeted_has_the_board(self, served, link):
        until(lambda: served.server.busy, "the board knows its host")
        assert decode_read(answer_of(link))["application_name"] == "ABSSIM"

    def test_a_second_host_is_refused_by_name_and_the_first_is_not_disturbed(self, served, link):
        for _ in range(3):
            with pytest.raises(BoardError, match=r"another host.*one program at a time") as refusal:
                SocketLink(served.path)
            assert served.path in str(refusal.value)
            assert not isinstance(refusal.value, LinkError)
            assert len(answer_of(link)) == FRAME_BYTES
        assert served.front_end.rejected == 0

    def test_without_a_listener_there_is_no_board(self, path):
        with pytest.raises(BoardError, match=r"no board at .*No such file"):
            SocketLink(path)

    def test_a_socket_that_a_dead_board_has_left_is_not_a_board(self, path):
        SocketServer(None, path).close()
        with pytest.raises(BoardError, match=r"no board at .*refused"):
            SocketLink(path)

    def test_a_file_is_not_a_board(self, path):
        Path(path).write_bytes(b"")
        with pytest.raises(BoardError, match="no board at"):
            SocketLink(path)

    def test_a_name_that_no_socket_can_have_is_not_a_board(self):
        with pytest.raises(BoardError, match=r"no board at .*too long"):
            SocketLink("/tmp/" + 200 * "x")  # noqa: S108  it is never made

    @pytest.mark.parametrize("greeting", [b"x", b"boar", b"hello, I am another program"])
    def test_another_programs_greeting_is_not_accepted(self, path, greeting):
        board = Scripted(path, greeting)
        try:
            with pytest.raises(BoardError):
                SocketLink(path)
        finally:
            board.close()

    def test_a_board_that_does_not_greet_is_given_up(self, path, monkeypatch):
        monkeypatch.setattr(links, "_GREETING_S", 0.05)
        board = Scripted(path, b"")
        try:
            with pytest.raises(BoardError, match=r"no board at .*timed out"):
                SocketLink(path)
        finally:
            board.close()

    def test_a_refused_visitor_leaves_nothing_open(self, served, link):
        assert link
        for _ in range(3):
            with pytest.raises(BoardError):
                SocketLink(served.path)
        gc.collect()  # an open socket would be a warning, and so an error

    def test_a_board_at_an_address_is_opened_by_it(self, served):
        board = open_board(f"sim:{served.path}", served.config, time.monotonic_ns)
        assert isinstance(board, RtdacUsb2)
        until(lambda: served.server.busy, "the board knows its host")
        board.__exit__(None, None, None)
        until(lambda: not served.server.busy, "it is free again")


class TestMessages:
    def test_messages_keep_their_boundaries_and_their_order(self, mute):
        link, board = mute
        for message in (b"one", b"three", bytes(FRAME_BYTES)):
            link.write(message)
        assert [board.recv(4096) for _ in range(3)] == [b"one", b"three", bytes(FRAME_BYTES)]
        for message in (b"four", b"five"):
            board.send(message)
        assert [link.read(FRAME_BYTES) for _ in range(2)] == [b"four", b"five"]

    def test_a_read_returns_at_most_the_requested_bytes_and_drops_the_rest(self, mute):
        link, board = mute
        board.send(b"three")
        board.send(b"four")
        assert [link.read(2), link.read(10)] == [b"th", b"four"]

    def test_no_answer_is_a_link_error_after_the_time_out_and_not_before(self, mute):
        link, _ = mute
        before = time.monotonic()
        with pytest.raises(LinkError, match="did not answer within 10 ms"):
            link.read(FRAME_BYTES)
        assert 0.009 < time.monotonic() - before < PATIENCE_S

    def test_the_kernel_waits_for_the_board_for_10_ms_or_as_long_as_set(self, path, monkeypatch):
        made = []

        class Kept(socket.socket):
            def setsockopt(self, *option):
                super().setsockopt(*option)
                made.append(self)

        board = Scripted(path, GREETING)
        monkeypatch.setattr(links.socket, "socket", Kept)
        link, options = SocketLink(path), (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO)
        set_times = [made[0].getsockopt(socket.SOL_SOCKET, option, 16) for option in options]
        link.timeout_s = 1.5
        longer_times = [made[0].getsockopt(socket.SOL_SOCKET, option, 16) for option in options]
        link.close()
        board.close()
        for seconds, microseconds in map(struct.Struct("ll").unpack, set_times):
            assert (seconds, 10_000 <= microseconds < 20_000) == (0, True)  # the kernel counts its own ticks
        for seconds, microseconds in map(struct.Struct("ll").unpack, longer_times):
            assert (seconds, 500_000 <= microseconds < 510_000) == (1, True)

    def test_an_answer_that_comes_after_the_time_out_is_still_there(self, mute):
        link, board = mute
        with pytest.raises(LinkError):
            link.read(10)
        board.send(b"late")
        assert link.read(10) == b"late"

    def test_a_board_that_no_longer_accepts_data_is_a_link_error(self, mute):
        link, _ = mute

        def write_for_ever():
            while True:
                link.write(bytes(FRAME_BYTES))

        with pytest.raises(LinkError, match="cannot be reached"):
            write_for_ever()


class TestDiscard:
    def test_what_has_arrived_is_dropped_and_what_comes_later_is_not(self, mute):
        link, board = mute
        for message in (b"one", b"two"):
            board.send(message)
        link.discard(10)
        board.send(b"three")
        assert link.read(10) == b"three"

    def test_it_does_not_wait_for_what_has_not_arrived(self, mute):
        link, _ = mute
        before = time.monotonic()
        for _ in range(200):
            link.discard(10)
        assert time.monotonic() - before < 200 * 0.010

    def test_it_comes_to_an_end_when_there_is_always_more(self, mute):
        link, board = mute
        for number in range(40):
            board.send(bytes([number]))
        link.discard(10)
        assert 0 < link.read(10)[0] < 40


class TestTheBoardGoesAway:
    @pytest.fixture
    def orphan(self, mute):
        link, board = mute
        board.close()
        return link

    def test_nothing_can_be_written_afterwards(self, orphan):
        with pytest.raises(LinkError, match="cannot be reached: Broken pipe"):
            orphan.write(READ_REQUEST)

    def test_nothing_can_be_read_afterwards(self, orphan):
        with pytest.raises(LinkError, match=r"closed the connection|cannot be reached"):
            orphan.read(FRAME_BYTES)

    def test_dropping_answers_raises_nothing(self, orphan):
        orphan.discard(FRAME_BYTES)

    def test_its_earlier_messages_stay_readable(self, mute):
        link, board = mute
        board.send(b"last words")
        board.close()
        assert link.read(20) == b"last words"
        with pytest.raises(LinkError):
            link.read(20)

    def test_a_closed_link_carries_nothing_and_may_be_closed_again(self, link):
        for _ in range(2):
            link.close()
        for use in (lambda: link.write(b"x"), lambda: link.read(1)):
            with pytest.raises(LinkError, match="cannot be reached"):
                use()
        link.discard(1)


class TestTheHostGoesAway:
    def test_the_board_is_free_and_its_outputs_stay_as_they_were(self, served):
        link = served.link()
        served.drive(link)
        link.close()
        until(lambda: not served.server.busy, "the board is free")
        assert served.device.duties == BOTH
        with_next = served.link()
        assert decode_read(answer_of(with_next))["pwm0_width"] == 255
        with_next.close()

    def test_a_host_that_is_killed_frees_the_board_and_its_outputs_stay_as_they_were(self, served):
        link = served.link()
        served.drive(link)
        link.close()
        until(lambda: not served.server.busy, "the board is free")
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        connection.connect(served.path)
        assert connection.recv(100) == GREETING
        with subprocess.Popen(["sleep", "600"], pass_fds=[connection.fileno()]) as host:
            connection.close()
            with pytest.raises(BoardError, match="another host"):
                SocketLink(served.path)
            host.send_signal(signal.SIGKILL)
        until(lambda: not served.server.busy, "the board is free")
        assert served.device.duties == BOTH

    def test_answers_that_it_has_not_read_do_not_reach_the_next_host(self, served):
        link = served.link()
        for _ in range(3):
            link.write(READ_REQUEST)
        link.close()
        after = served.link()
        with pytest.raises(LinkError, match="did not answer"):
            after.read(FRAME_BYTES)
        after.close()

    def test_a_host_that_does_not_read_does_not_stop_the_board(self, served):
        link = served.link()
        for _ in range(2000):
            with suppress(LinkError):  # the socket is full; the board's thread has to come to its turn
                link.write(READ_REQUEST)
        with pytest.raises(BoardError, match="another host"):
            SocketLink(served.path)
        link.close()
        until(lambda: not served.server.busy, "the board is free")

    def test_a_host_that_hangs_up_at_once_leaves_room_for_the_next(self, served):
        for _ in range(20):
            host = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            host.connect(served.path)
            host.close()
        link = served.link()
        assert len(answer_of(link)) == FRAME_BYTES
        link.close()

    def test_what_is_not_a_frame_is_dropped_and_the_next_is_answered(self, served, link):
        link.write(b"nonsense")
        assert len(answer_of(link)) == FRAME_BYTES
        assert served.front_end.rejected == 1


def test_the_rig_moves_on_between_requests(served):
    link = served.link()
    served.drive(link)
    link.close()
    until(lambda: served.device.plant.road_speed > 0.0, "the road turns")


def test_a_board_over_a_socket_drives_the_rig_and_leaves_it_safe(served, monkeypatch):
    for module, name in ((links, "PATIENCE_S"), (frames, "_LEAST_TIMEOUT_S")):
        monkeypatch.setattr(module, name, PATIENCE_S)  # the board's thread may be late
    with open_board(f"sim:{served.path}", served.config, time.monotonic_ns) as board:
        samples = [board.exchange(Command(1.0, 0.0)) for _ in range(20)]
    assert [sample.tick for sample in samples] == list(range(20))
    assert served.device.duties == OFF
