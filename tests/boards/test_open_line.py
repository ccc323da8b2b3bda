"""The open board at the end of a line: whole frames out of bytes, found by its answer, listed without opening."""

import os
import threading
import time
from types import SimpleNamespace

import pytest

from firmware_protocol.open_board import QUERY, REPORT, STATUS
from inteco_abs.boards import check_address, open_board
from inteco_abs.boards.families.open import line
from inteco_abs.boards.families.open.host import HOST
from inteco_abs.boards.families.open.line import FramedLine, only_port
from inteco_abs.boards.families.open.mock import FrameStream
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError, LinkError, NoAnswerError
from inteco_abs.host import Computer, Rating
from inteco_abs.mock_board import Device, PtyServer, front_end_of
from inteco_abs.signals import BoardFlags, Command

BAUD = 1_000_000


@pytest.fixture
def pair():
    """Our end of a terminal, and the line at its other one."""
    ours, theirs = os.openpty()
    path = os.ttyname(theirs)
    link = FramedLine(path, BAUD)
    os.read(ours, 1)  # the first generation's DUMMY, which an open board ignores
    yield ours, link
    link.close()
    os.close(ours)
    os.close(theirs)


def test_frames_come_whole_however_the_bytes_arrive(pair):
    ours, link = pair
    first, second = REPORT.encode({"tick": 1}, sequence=1), STATUS.encode(sequence=2)
    os.write(ours, first[:7])
    with pytest.raises(NoAnswerError, match="within 10 ms"):
        link.read(60)
    os.write(ours, first[7:] + second)
    assert [link.read(60), link.read(60)] == [first, second]


def test_damage_and_noise_between_frames_are_dropped(pair):
    ours, link = pair
    damaged = bytearray(STATUS.encode(sequence=3))
    damaged[9] ^= 4
    os.write(ours, b"\x00\xff" + bytes(damaged) + b"noise" + STATUS.encode(sequence=4))
    assert link.read(60) == STATUS.encode(sequence=4)


def test_old_frames_are_discarded_and_half_of_one_too(pair):
    ours, link = pair
    os.write(ours, STATUS.encode(sequence=3) + STATUS.encode(sequence=4)[:20])
    link.discard(60)
    os.write(ours, STATUS.encode(sequence=5))
    assert link.read(60) == STATUS.encode(sequence=5)


def test_what_is_written_goes_out_as_it_is(pair):
    ours, link = pair
    link.write(QUERY.encode(sequence=9))
    assert os.read(ours, 100) == QUERY.encode(sequence=9)


def test_a_line_that_is_gone_is_a_link_error():
    ours, theirs = os.openpty()
    link = FramedLine(os.ttyname(theirs), BAUD)
    os.close(ours)
    os.close(theirs)
    with pytest.raises(LinkError, match="the board is gone: check cable and power"):
        link.read(60)
    link.close()


class Answering:
    """A mock open board at a terminal, in a thread."""

    def __init__(self):
        config = load_config(profile="sim_open")
        self.server = PtyServer(FrameStream(front_end_of(Device(config, time.monotonic_ns))))
        self.path = self.server.name
        self._thread = threading.Thread(target=self.server.serve)
        self._thread.start()

    def close(self):
        self.server.close()
        self._thread.join()


@pytest.fixture
def answering():
    boards = []

    def make():
        boards.append(Answering())
        return boards[-1].path

    yield make
    for board in boards:
        board.close()


@pytest.fixture
def silent():
    ours, theirs = os.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


@pytest.fixture
def plugged(monkeypatch):
    def plug(*ports):
        found = [SimpleNamespace(device=path, vid=vid) for path, vid in ports]
        monkeypatch.setattr(line.list_ports, "comports", lambda: found)

    return plug


def test_the_board_is_found_among_the_ports_by_what_answers(plugged, answering, silent):
    path = answering()
    plugged((silent, 0x2E8A), (path, 0x1209), ("/dev/ttyS0", None))
    assert only_port(BAUD) == path


def test_ports_of_ftdi_chips_are_not_asked(plugged, answering):
    plugged((answering(), 0x0403))
    with pytest.raises(BoardError, match=r"no serial port of a USB device.*behind an FTDI chip"):
        only_port(BAUD)


def test_two_boards_must_be_named(plugged, answering):
    plugged((answering(), 0x1209), (answering(), 0x1209))
    with pytest.raises(BoardError, match=r"2 open boards answer, at /dev/pts/.*: name one, as in open:/dev/pts/"):
        only_port(BAUD)


def test_without_one_the_ports_that_were_asked_are_named(plugged, silent):
    plugged((silent, 0x2E8A))
    with pytest.raises(BoardError, match=f"no open board: none of {silent} answers"):
        only_port(BAUD)


def test_a_port_that_is_not_there_is_named_with_those_that_are(plugged):
    plugged(("/dev/ttyACM7", 0x1209), ("/dev/ttyS0", None))
    with pytest.raises(BoardError, match="nowhere cannot be opened: there is no such port; seen: /dev/ttyACM7"):
        FramedLine("/nowhere", BAUD)


def test_an_address_opens_it(answering, until):
    path = answering()
    check_address(f"open:{path}")
    with open_board(f"open:{path}", load_config(profile="sim_open"), time.monotonic_ns) as board:
        assert str(board.identity) == "logic 0x0B01 'OPENSIM' of 20260101"
        # on a busy computer the thread that answers may miss a period
        until(lambda: board.exchange(Command(0.1, 0.0)).board_flags is not BoardFlags.STALE, "a good exchange")


class TestListing:
    @pytest.fixture
    def computer(self, tmp_path):
        device = tmp_path / "sys/devices/usb1/1-2"
        interface = device / "1-2:1.0"
        port = interface / "tty" / "ttyACM0"
        port.mkdir(parents=True)
        (port / "device").symlink_to(interface)
        for name, text in {"idVendor": "1209", "idProduct": "0001", "product": "open board", "serial": "E66"}.items():
            (device / name).write_text(f"{text}\n")
        (tmp_path / "sys/class/tty").mkdir(parents=True)
        (tmp_path / "sys/class/tty/ttyACM0").symlink_to(port)
        (tmp_path / "dev").mkdir()
        (tmp_path / "dev/ttyACM0").write_text("")
        return Computer(tmp_path)

    def test_a_port_is_listed_with_its_device(self, computer):
        (found,) = HOST.found(computer, load_config(), "")
        assert found.address == "open:/dev/ttyACM0"
        assert "1209:0001 product 'open board' serial 'E66'" in found.description
        assert found.told["product"] == "open board"

    def test_a_named_port_that_is_not_there_is_not_listed(self, computer):
        assert HOST.found(computer, load_config(), "/dev/no-such-port") == []

    def test_a_named_terminal_is_listed_as_what_it_is(self, computer, silent):
        (found,) = HOST.found(computer, load_config(), silent)
        assert found.address == f"open:{silent}"
        assert "not of a USB device" in found.description

    def test_its_access_is_checked(self, computer, monkeypatch):
        (folder,) = HOST.folders(computer)
        check = HOST.checks["serial port"]
        assert check(computer, folder).verdict is Rating.GREEN
        monkeypatch.setattr(os, "access", lambda *_: False)
        refused = check(computer, folder)
        assert refused.verdict is Rating.RED
        assert "usermod -aG" in refused.fix
