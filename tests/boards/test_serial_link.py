"""The serial link on a pseudo-terminal: answers in pieces or in part, boards that go, ports that cannot be had."""

import errno
import fcntl
import os
import signal
import struct
import subprocess
import sys
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial

from firmware_protocol.rtdac_usb import DUMMY, FRAME_BYTES, READ_REQUEST, encode_read, encode_send
from inteco_abs.boards import board_behind, open_board
from inteco_abs.boards.families.usb.mock import ByteStream
from inteco_abs.boards.transports import serial_link, serial_ports
from inteco_abs.boards.transports.serial_link import SerialLink
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError, LinkError, UnsafeError
from inteco_abs.mock_board import Device, PtyServer, front_end_of
from inteco_abs.realtime import round_trips
from inteco_abs.signals import Command
from inteco_abs.wire.recording import RecordingLink

PATIENT_S = 10.0


class Board:
    """The far end of a terminal, by hand."""

    def __init__(self):
        self.ours, self._host = os.openpty()
        tty.setraw(self._host)
        self.path = os.ttyname(self._host)

    def say(self, data):
        os.write(self.ours, data)

    def receive(self, length):
        data = b""
        while len(data) < length:
            data += os.read(self.ours, length - len(data))
        return data

    def go(self):
        for descriptor in (self.ours, self._host):
            if descriptor >= 0:
                os.close(descriptor)
        self.ours = self._host = -1


@pytest.fixture
def board():
    board = Board()
    yield board
    board.go()


@pytest.fixture
def link(board):
    link = SerialLink(board.path, PATIENT_S)
    assert board.receive(1) == DUMMY
    yield link
    link.close()


class SlowServer(PtyServer):
    """Takes its time over everything."""

    delay_s = 0.0

    def step(self):
        time.sleep(self.delay_s)
        super().step()


@pytest.fixture
def served():
    """The mock behind a terminal in a thread."""
    config = load_config(profile="sim_usb")
    server = SlowServer(ByteStream(front_end_of(Device(config, time.monotonic_ns))))
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield config, server
    server.close()
    thread.join()


def impatient(link):
    """The link with a time-out that a test can wait for."""
    link._port.timeout = link._timeout_s = 0.05  # the one place where it can be had
    return link


class TestBytes:
    def test_opening_leaves_programming_mode_and_says_nothing_else(self, board, link):
        link.write(READ_REQUEST)
        assert board.receive(1) == READ_REQUEST

    def test_an_answer_that_comes_in_pieces_is_one_answer(self, board, link):
        answer = bytes(range(150))

        def dribble():
            for at in range(0, 150, 37):
                board.say(answer[at : at + 37])
                time.sleep(0.002)

        thread = threading.Thread(target=dribble)
        thread.start()
        assert link.read(150) == answer
        thread.join()

    def test_two_answers_that_come_at_once_are_two_answers(self, board, link):
        board.say(b"a" * 150 + b"b" * 150)
        assert [link.read(150), link.read(150)] == [b"a" * 150, b"b" * 150]

    def test_all_bytes_pass_as_they_are(self, board, link):
        board.say(bytes(range(256)))
        assert link.read(256) == bytes(range(256))
        link.write(bytes(range(256)))
        assert board.receive(256) == bytes(range(256))

    def test_an_exchange_writes_frame_and_request_in_one(self, board, link):
        board.say(b"x" * 150)
        assert link.exchange(bytearray(b"\x81" * 150), READ_REQUEST, 150) == b"x" * 150
        assert os.read(board.ours, 1000) == b"\x81" * 150 + READ_REQUEST

    def test_what_was_left_over_is_dropped_on_opening(self, board):
        board.say(b"left over" * 20)
        link = SerialLink(board.path, PATIENT_S)
        board.say(b"new")
        assert link.read(3) == b"new"
        link.close()

    def test_a_board_that_keeps_sending_does_not_keep_the_link_from_opening(self, board):
        ended = threading.Event()

        def chatter():
            while not ended.is_set():
                board.say(b"chatter")
                time.sleep(0.0005)

        thread = threading.Thread(target=chatter)
        thread.start()
        SerialLink(board.path, PATIENT_S).close()
        ended.set()
        thread.join()


class TestFailures:
    def test_no_answer_is_a_link_error(self, link):
        with pytest.raises(LinkError, match="did not answer within 50 ms"):
            impatient(link).read(150)

    def test_part_of_an_answer_is_a_link_error_that_says_how_much_came(self, board, link):
        board.say(b"x" * 30)
        with pytest.raises(LinkError, match="30 of 150 bytes of an answer came within 50 ms"):
            impatient(link).read(150)

    def test_after_it_discarding_brings_bytes_and_answers_together_again(self, board, link):
        board.say(b"x" * 30)
        with pytest.raises(LinkError):
            impatient(link).read(150)
        board.say(b"x" * 120)
        link.discard(150)
        board.say(b"y" * 150)
        assert link.read(150) == b"y" * 150

    def test_discarding_waits_for_what_is_still_on_its_way(self, board, link):
        board.say(b"x")
        thread = threading.Timer(0.001, lambda: board.say(b"x" * 60))
        thread.start()
        for _ in range(50):
            link.discard(150)
        thread.join()
        board.say(b"y")
        assert link.read(1) == b"y"

    def test_a_board_that_takes_nothing_is_a_link_error(self, link):
        link._port.write_timeout = link._timeout_s = 0.05
        with pytest.raises(LinkError, match="took no data within 50 ms"):
            link.write(bytes(100_000))

    def test_every_call_reports_a_board_that_has_disappeared(self, board, link):
        board.go()
        for attempt in (lambda: link.read(150), lambda: link.write(b"x"), lambda: link.exchange(b"x", b"y", 150)):
            with pytest.raises(LinkError, match="is gone: check cable and power"):
                attempt()
        link.discard(150)
        link.close()
        link.close()

    def test_a_board_that_disappears_during_a_wait_is_reported(self, board, link):
        timer = threading.Timer(0.05, board.go)
        timer.start()
        with pytest.raises(LinkError, match="is gone"):
            link.read(150)
        timer.join()  # it may still have the other end to close

    def test_a_closed_link_is_a_link_error(self, link):
        link.close()
        for attempt in (lambda: link.read(1), lambda: link.write(b"x")):
            with pytest.raises(LinkError):
                attempt()
        link.discard(1)


TIOCGEXCL = 0x80045440
"""Linux: whether a terminal is closed to further opens; the termios module does not have it."""
HOLDER = (
    "import sys, time; from inteco_abs.boards.transports.serial_link import SerialLink; "
    "link = SerialLink(sys.argv[1]); "
)


class TestPorts:
    def test_a_port_has_one_program_at_a_time(self, board, link):
        with pytest.raises(BoardError, match=f"{board.path} cannot be opened: another program has it"):
            SerialLink(board.path)
        link.write(b"x")
        assert board.receive(1) == b"x"
        link.close()
        SerialLink(board.path).close()

    def test_a_program_that_was_killed_leaves_the_port_free(self, board):
        holder = subprocess.Popen(
            [sys.executable, "-c", HOLDER + "print('open', flush=True); time.sleep(60)", board.path],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert holder.stdout.readline() == "open\n"
        with pytest.raises(BoardError, match="another program has it"):
            SerialLink(board.path)
        holder.send_signal(signal.SIGKILL)
        holder.communicate()
        SerialLink(board.path).close()

    @pytest.mark.parametrize(("terminals", "closed"), [("/dev/pts/", 0), ("/not/this/one/", 1)])
    def test_a_port_is_closed_to_all_but_a_pseudo_terminal_which_would_stay_so(
        self, monkeypatch, board, terminals, closed
    ):
        monkeypatch.setattr(serial_link, "_PSEUDO_TERMINALS", terminals)
        link = SerialLink(board.path, PATIENT_S)
        assert struct.unpack("i", fcntl.ioctl(board._host, TIOCGEXCL, bytes(4))) == (closed,)
        link.close()

    def test_a_port_that_is_not_there_is_reported_with_those_that_are(self, monkeypatch, tmp_path):
        plug_in(monkeypatch, "/dev/ttyUSB3")
        with pytest.raises(BoardError, match=r"nowhere cannot be opened: there is no such port; seen: /dev/ttyUSB3 \("):
            SerialLink(str(tmp_path / "nowhere"))

    def test_what_is_not_a_serial_port_is_asked_about(self, tmp_path):
        (tmp_path / "file").write_text("")
        for path in ("/dev/null", str(tmp_path / "file")):
            with pytest.raises(BoardError, match="is it a serial port"):
                SerialLink(path)

    @pytest.mark.parametrize(
        ("number", "words"),
        [(errno.EACCES, "no permission: its group is .*usermod -aG"), (errno.EBUSY, "another program has it")],
    )
    def test_a_port_that_may_not_be_opened_says_why(self, monkeypatch, board, number, words):
        def refuse(*_arguments, **_options):
            raise serial.SerialException(number, "could not open port")

        monkeypatch.setattr(serial, "Serial", refuse)
        with pytest.raises(BoardError, match=words):
            SerialLink(board.path)

    def test_a_group_without_a_name_is_reported_by_its_number(self, monkeypatch, board):
        def nameless(number):
            raise KeyError(number)

        monkeypatch.setattr(serial, "Serial", denied)
        monkeypatch.setattr(serial_link.grp, "getgrgid", nameless)
        with pytest.raises(BoardError, match=f"its group is {Path(board.path).stat().st_gid};"):
            SerialLink(board.path)

    def test_what_an_earlier_program_has_left_is_dropped_before_the_board_is_identified(self, board, link):
        board.say(b"old")
        link.prepare(3)
        board.say(b"new")
        assert link.read(3) == b"new"


def plug_in(monkeypatch, *paths, other="/dev/ttyS0"):
    def port(path, vid):
        return SimpleNamespace(device=path, vid=vid, description="a port", serial_number="S1")

    ports = [port(other, None), *(port(path, 0x0403) for path in paths)]
    monkeypatch.setattr(serial_ports.list_ports, "comports", lambda: ports)


class TestOnlyPort:
    def test_the_only_ftdi_port_is_taken(self, monkeypatch):
        plug_in(monkeypatch, "/dev/ttyUSB7")
        assert serial_ports.only_port() == "/dev/ttyUSB7"

    def test_no_port_is_an_error_that_asks_for_the_cable(self, monkeypatch):
        plug_in(monkeypatch)
        with pytest.raises(BoardError, match=r"no RT-DAC/USB: .*0403.*plugged in"):
            open_board("usb:", load_config(profile="sim_usb"), time.monotonic_ns)

    def test_several_are_an_error_that_names_them_all(self, monkeypatch):
        plug_in(monkeypatch, "/dev/ttyUSB0", "/dev/ttyUSB1")
        with pytest.raises(BoardError, match=r"2 ports.*usb:/dev/ttyUSB0.*/dev/ttyUSB0 \(.*/dev/ttyUSB1 \("):
            serial_ports.only_port()


class TestLatencyTimer:
    @pytest.fixture
    def timer(self, tmp_path):
        (tmp_path / "ttyUSB0").mkdir()
        file = tmp_path / "ttyUSB0" / "latency_timer"
        file.write_text("16\n")
        return file

    def test_it_is_set_to_a_millisecond_through_any_links_to_the_port(self, tmp_path, timer):
        (tmp_path / "rig").symlink_to("/dev/ttyUSB0")
        assert serial_ports.set_latency_timer(str(tmp_path / "rig"), tmp_path) == ""
        assert timer.read_text() == "1\n"

    def test_the_vendors_event_character_is_enabled_where_the_chip_has_one(self, tmp_path, timer):
        event = timer.with_name("event_char")
        event.write_text("")
        assert serial_ports.set_latency_timer("/dev/ttyUSB0", tmp_path) == ""
        assert int(event.read_text()) == 0x13F

    def test_one_that_stays_long_is_reported_with_the_rule_that_helps(self, tmp_path, timer, monkeypatch):
        monkeypatch.setattr(type(timer), "write_text", denied)
        complaint = serial_ports.set_latency_timer("/dev/ttyUSB0", tmp_path)
        assert "waits 16 ms" in complaint
        assert "inteco-abs doctor --rules" in complaint
        assert str(timer) in complaint

    def test_one_that_is_short_already_need_not_be_set(self, tmp_path, timer, monkeypatch):
        timer.write_text("1\n")
        monkeypatch.setattr(type(timer), "write_text", denied)
        assert serial_ports.set_latency_timer("/dev/ttyUSB0", tmp_path) == ""

    def test_a_port_without_one_is_fine(self, tmp_path):
        assert serial_ports.set_latency_timer("/dev/pts/5", tmp_path) == ""

    def test_one_that_cannot_be_read_is_reported(self, tmp_path, timer, monkeypatch):
        timer.write_text("soon")
        monkeypatch.setattr(type(timer), "write_text", denied)
        assert "cannot be read" in serial_ports.set_latency_timer("/dev/ttyUSB0", tmp_path)

    def test_a_board_that_is_too_slow_is_not_opened_but_is_rescued(self, monkeypatch, served):
        config, server = served
        device = server._stream.front_end.device  # the mock's own state
        header = encode_read({"application_name": "ABSIM"}, logic=0x0111)[:8]
        image = header + encode_send({"pin_mode": 0b11}, logic=0x0111)
        device.write({"pin_mode": 0b11, "pwm0_width": 255})
        monkeypatch.setattr(serial_link, "set_latency_timer", lambda _path: "each answer waits 16 ms")
        with pytest.raises(BoardError, match="waits 16 ms"):
            new_board(config, server).__enter__()
        assert device.duties == (1.0, 0.0)
        new_board(config, server).rescue(image)
        assert device.duties == (0.0, 0.0)

    def test_one_that_is_recorded_is_refused_just_so(self, monkeypatch, served, tmp_path):
        config, server = served
        monkeypatch.setattr(serial_link, "set_latency_timer", lambda _path: "each answer waits 16 ms")
        link = RecordingLink(SerialLink(server.name, PATIENT_S), tmp_path / "wire.jsonl", board="usb1-111")
        with pytest.raises(BoardError, match="waits 16 ms"):
            board_behind(link, config, time.monotonic_ns).__enter__()


def denied(*_arguments, **_options):
    raise PermissionError(errno.EACCES, "Permission denied")


def new_board(config, server):
    board = board_behind(SerialLink(server.name, PATIENT_S), config, time.monotonic_ns)
    board.hurried = False  # a busy computer may be late
    return board


class TestWithTheMock:
    @pytest.mark.untraced
    def test_the_board_keeps_its_state_when_hosts_disconnect(self, served):
        config, server = served
        for drive in (0.2, 0.4, 0.6):
            with new_board(config, server) as board:
                counts = [board.exchange(Command(drive, 0.0)).road_count for _ in range(200)]
                assert counts == sorted(counts)
                assert board.link_errors == 0
        assert server.lost_bytes == 0

    def test_after_a_host_died_in_the_middle_of_a_frame_the_board_still_answers(self, served):
        config, server = served
        link = SerialLink(server.name, PATIENT_S)
        link.write(encode_send({"pwm0_width": 9}, logic=0x0111)[:70])
        link.close()
        with new_board(config, server) as board:
            assert board.identity.application_name == "ABSIM"

    def test_answers_that_the_host_does_not_read_are_lost_and_the_next_host_is_served(self, served):
        config, server = served
        link = SerialLink(server.name, PATIENT_S)
        end = time.monotonic() + 60.0
        while not server.lost_bytes:
            link.write(READ_REQUEST)
            assert time.monotonic() < end
        link.close()
        answered = False
        while not answered:
            assert time.monotonic() < end
            with suppress(LinkError), new_board(config, server) as board:  # until the server has seen the hang-up
                answered = board.exchange(Command.SAFE).board_flags == 0

    def test_board_that_disappears_in_a_run_is_not_safe_and_the_user_is_warned(self, served):
        config, server = served
        board = new_board(config, server).__enter__()
        board.exchange(Command(0.5, 0.0))
        server.close()
        end = time.monotonic() + 60.0
        while not board.link_errors:
            board.exchange(Command(0.5, 0.0))
            assert time.monotonic() < end
        with pytest.raises(UnsafeError, match=r"is gone.*MOTOR POWER MAY STILL BE ON"):
            board.__exit__(None, None, None)

    def test_a_rate_that_the_board_cannot_keep_is_refused_with_one_that_it_can(self, served, monkeypatch):
        config, server = served
        monkeypatch.setattr(round_trips, "_RATE_TRIALS", 50)
        server.delay_s = 0.006
        with (
            new_board(config, server) as board,
            pytest.raises(BoardError, match="longer than the period of 4000 us") as e,
        ):
            round_trips.require_rate(board, config.period_ns)
        rate_hz = int(str(e.value).partition("set loop.rate_hz to ")[2].split()[0])
        assert 1 <= rate_hz <= 1 / (1.2 * 0.006)

    def test_an_answer_of_the_whole_length_has_no_wrong_bytes(self, served):
        _, server = served
        link = SerialLink(server.name, PATIENT_S)
        link.write(READ_REQUEST)
        assert link.read(FRAME_BYTES)[:8] == b"\x11\x01\0MISBA"
        link.close()

    def test_a_link_to_the_port_is_made_replaced_and_taken_away(self, tmp_path):
        stream = ByteStream(front_end_of(Device(load_config(profile="sim_usb"), time.monotonic_ns)))
        path = tmp_path / "port"
        path.symlink_to("/dev/pts/99999")
        server = PtyServer(stream, path)
        assert str(path.readlink()) == server.name
        server.hang_up()
        assert not path.is_symlink()
        path.write_text("mine")
        with pytest.raises(BoardError, match=r"port: no symbolic link .* can be made there: File exists"):
            PtyServer(stream, path)
        assert path.read_text() == "mine"


def test_an_answer_is_waited_for_far_shorter_than_a_loop_may_be_silent():
    assert load_config(profile="usb1_0111").guard.silence_s >= 5 * serial_link.TIMEOUT_S


@pytest.mark.parametrize(("complaint", "within"), [("", "90 ms"), ("each answer waits 16 ms", "100 ms")])
def test_only_an_answer_from_a_slow_chip_is_waited_for_longer(board, monkeypatch, complaint, within):
    monkeypatch.setattr(serial_link, "set_latency_timer", lambda _path: complaint)
    link = SerialLink(board.path, 0.09)
    with pytest.raises(LinkError, match=f"did not answer within {within}"):
        link.read(150)
    link.close()
