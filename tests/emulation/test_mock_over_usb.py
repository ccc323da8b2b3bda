"""The mock board behind pyusb gives the same answers as its front end does directly."""

import errno

import pytest
import usb.core
import usb.util
from check_list import fails
from drill import HandClock, new_front_end, new_host
from hypothesis import given
from hypothesis import strategies as st
from pyusb_backend import BusBackend

from firmware_protocol.rtdac_usb2 import FRAME_BYTES, READ_REQUEST, encode_send
from inteco_abs.mock_board import UsbBoard, UsbIdentity, UsbSpeed
from inteco_abs.mock_board.usbip.usb_descriptors import MOCK_SERIALS
from inteco_abs.mock_board.usbip.usb_device import Handshake, SetupPacket

DRIVING = {"pin_mode": 0b100100, "pwm0_mode": 1, "pwm0_width": 4095, "pwm0_prescaler": 0xFFFF}


def test_frames_are_those_of_the_face(real_board, clock):
    device, board = real_board
    twin_clock = HandClock()
    twin_clock.time_ns = clock.time_ns
    twin = new_front_end(twin_clock)
    for width in (0, 4095, 17):
        frame = encode_send({**DRIVING, "pwm0_width": width})
        assert device.write(0x02, frame) == FRAME_BYTES
        twin.bulk_out(frame)
        for _ in range(3):
            clock.time_ns += 500_000
            twin_clock.time_ns = clock.time_ns
            assert device.write(0x02, READ_REQUEST) == 4
            twin.bulk_out(READ_REQUEST)
            assert bytes(device.read(0x84, FRAME_BYTES)) == twin.bulk_in(FRAME_BYTES)
    assert board.front_end.rejected == 0


def test_whole_answer_into_a_larger_buffer(real_board):
    device, _ = real_board
    device.write(0x02, READ_REQUEST)
    assert len(device.read(0x84, 4096)) == FRAME_BYTES


def test_no_answer_without_a_request(real_board):
    device, _ = real_board
    assert fails(errno.ETIMEDOUT, device.read, 0x84, FRAME_BYTES, 30)


def test_wrong_messages_are_dropped(real_board):
    device, board = real_board
    for message in (b"\xff\x8f", bytes(505), bytes(100)):
        device.write(0x02, message)
    device.write(0x02, READ_REQUEST)
    assert len(device.read(0x84, FRAME_BYTES)) == FRAME_BYTES
    assert board.front_end.rejected == 3


def test_an_endless_message_uses_bounded_memory(real_board):
    device, board = real_board
    for _ in range(20):
        device.write(0x02, bytes(1 << 16))
    device.write(0x02, b"end")
    assert board.front_end.rejected == 1
    device.write(0x02, READ_REQUEST)
    assert len(device.read(0x84, FRAME_BYTES)) == FRAME_BYTES


def test_unread_answers_are_bounded(real_board):
    device, board = real_board
    for _ in range(100):
        device.write(0x02, READ_REQUEST)
    assert 80 < board.lost_answers < 100
    for _ in range(100 - board.lost_answers):
        assert len(device.read(0x84, FRAME_BYTES)) == FRAME_BYTES
    assert fails(errno.ETIMEDOUT, device.read, 0x84, FRAME_BYTES, 30)


def test_programming_endpoints_count_violations(real_board):
    device, board = real_board
    for _ in range(2):
        assert fails(errno.EPIPE, device.write, 0x06, b"bitstream")
        assert fails(errno.EPIPE, device.read, 0x88, 64)
        device.clear_halt(0x06)
        device.clear_halt(0x88)
    assert board.jtag_transfers == 4


def test_dates(real_board):
    device, _ = real_board
    addresses = bytes(device.ctrl_transfer(0xC0, 0xD9, 0, 0, 6))
    dates = []
    for at in (2, 4):
        text = bytes(device.ctrl_transfer(0xC0, 0xDA, int.from_bytes(addresses[at : at + 2], "little"), 0, 32))
        assert len(text) == 32
        dates.append(text[:20:2].decode())
    assert dates == ["2026-01-01", "2026-01-02"]
    assert fails(errno.EPIPE, device.ctrl_transfer, 0xC0, 0xDA, 0x7777, 0, 32)
    assert fails(errno.EPIPE, device.ctrl_transfer, 0xC0, 0xD9, 1, 0, 6)


def test_led(real_board):
    device, board = real_board
    device.ctrl_transfer(0x40, 0xDF)
    assert board.led
    device.ctrl_transfer(0x40, 0xDE)
    assert not board.led


def test_firmware_cannot_be_loaded(real_board):
    device, _ = real_board
    assert fails(errno.EPIPE, device.ctrl_transfer, 0x40, 0xA0, 0xE600, 0, b"\1")


def test_outputs_survive_a_bus_reset(real_board, level):
    device, board = real_board
    device.write(0x02, encode_send(DRIVING))
    device.write(0x02, READ_REQUEST)
    if level == "L2":
        device.reset()
        assert fails(errno.ETIMEDOUT, device.read, 0x84, FRAME_BYTES, 30)  # the answer did not
    assert board.front_end.device.duties[0] == 1.0


def test_bound_driver_missing_permission_and_another_board(clock):
    """What a lab without a udev rule sees, in process."""
    host = new_host(UsbSpeed.HIGH, drill=False, clock=clock)
    backend = BusBackend(host, clock.wait)
    backend.driver = "usbtest"
    device = usb.core.find(backend=backend)
    assert device.is_kernel_driver_active(0)
    assert fails(errno.EBUSY, device.set_configuration)
    device.detach_kernel_driver(0)
    device.set_configuration()
    usb.util.dispose_resources(device)
    backend.permitted = False
    assert fails(errno.EACCES, usb.core.find(backend=backend).set_configuration)
    host.unplug()
    assert usb.core.find(backend=backend) is None
    host.plug()
    assert usb.core.find(backend=backend).address == device.address + 1


def test_identity_must_be_a_mocks():
    for wrong in ({"serial": 12}, {"serial": MOCK_SERIALS.stop}, {"vendor_id": 0}, {"product_id": 0x10000}):
        with pytest.raises(ValueError, match=r"in \d|0x0001"):
            UsbIdentity(**wrong)


@pytest.mark.parametrize(
    "request_bytes",
    [
        "80 06 0006 0000 0a00",  # device qualifier
        "80 06 0102 0000 0900",  # second configuration
        "80 06 0403 0904 ff00",  # fourth string
        "00 09 0200 0000 0000",  # unknown configuration
        "01 0b 0100 0000 0000",  # unknown setting
        "81 0a 0000 0100 0100",  # unknown interface
        "82 00 0000 0300 0200",  # unknown endpoint
        "02 03 0100 8400 0000",  # another feature
        "00 03 0100 0000 0000",  # remote wake-up
        "21 00 0000 0000 0000",  # a class request
        "81 06 0001 0000 1200",  # descriptor of an interface
        "80 0c 0000 0000 0200",
        "00 01 0000 0000 0000",
        "82 01 0000 8400 0200",
    ],
)
def test_requests_that_stall(request_bytes):
    board = UsbBoard(new_front_end())
    board.control(SetupPacket(0, 9, 1, 0, 0))
    assert board.control(SetupPacket.unpack(bytes.fromhex(request_bytes))) is Handshake.STALL


def test_standard_requests():
    board = UsbBoard(new_front_end())

    def ask(text):
        return board.control(SetupPacket.unpack(bytes.fromhex(text)))

    assert ask("81 0a 0000 0000 0100") is Handshake.STALL  # there is no interface yet
    assert ask("00 05 0700 0000 0000") is Handshake.ACK
    assert ask("80 08 0000 0000 0100") == b"\0"
    assert ask("00 09 0100 0000 0000") is Handshake.ACK
    assert ask("80 08 0000 0000 0100") == b"\1"
    assert ask("81 0a 0000 0000 0100") == b"\0"
    assert ask("80 00 0000 0000 0200") == ask("81 00 0000 0000 0200") == ask("82 00 0000 0000 0200") == b"\0\0"
    assert ask("02 03 0000 8400 0000") is Handshake.ACK
    assert ask("82 00 0000 8400 0200") == b"\1\0"
    assert board.packet_in(0x84) is Handshake.STALL
    assert ask("01 0b 0000 0000 0000") is Handshake.ACK
    assert ask("82 00 0000 8400 0200") == b"\0\0"
    assert ask("80 06 0003 0000 ff00") == bytes.fromhex("04 03 0904")
    assert ask("80 06 0103 0904 ff00") == b"\x0e\x03" + "InTeCo".encode("utf-16-le")
    assert ask("80 06 0103 0904 0200") == b"\x0e\x03"
    assert ask("80 06 0002 0000 0900") == bytes.fromhex("09 02 2e00 01 01 00 80 32")
    with pytest.raises(ValueError, match="8 bytes"):
        ask("80 06")


class Recorder:
    """A front end that keeps its messages and answers as configured."""

    def __init__(self):
        self.got = []
        self.answers = []

    def bulk_out(self, data):
        self.got.append(bytes(data))

    def bulk_in(self, _length):
        return self.answers.pop(0) if self.answers else b""


speeds = st.sampled_from(UsbSpeed)
messages = st.binary(max_size=4000) | st.sampled_from([64, 128, 504, 512, 1024, 2048]).map(bytes)


@given(speed=speeds, sent=st.lists(messages, max_size=5))
def test_messages_survive_any_packet_size(speed, sent):
    """Messages of any length reach the board as they were written; the empty packet ends full ones."""
    front_end = Recorder()
    board = UsbBoard(front_end, UsbIdentity(speed=speed))
    size = speed.packet_bytes
    for message in sent:
        for at in range(0, len(message) + 1, size):
            assert board.packet_out(0x02, message[at : at + size]) is Handshake.ACK
    assert front_end.got == sent


@given(speed=speeds, answers=st.lists(st.binary(min_size=1, max_size=504), max_size=8))
def test_answers_survive_any_packet_size(speed, answers):
    front_end = Recorder()
    board = UsbBoard(front_end, UsbIdentity(speed=speed))
    front_end.answers = list(answers)
    board.packet_out(0x02, b"go")
    received, arriving = [], b""
    while (packet := board.packet_in(0x84)) is not Handshake.NAK:
        assert len(packet) <= speed.packet_bytes
        arriving += packet
        if len(packet) < speed.packet_bytes:
            received.append(arriving)
            arriving = b""
    assert (received, arriving) == (answers, b"")


@given(speed=speeds, sent=st.lists(messages.filter(bool), max_size=5), zero=st.booleans())
def test_writes_through_pyusb_survive_any_packet_size(speed, sent, zero):
    """As above through host and pyusb, which sends no empty packet: a full last packet runs into the next message."""
    host = new_host(speed, drill=False)
    host.device.front_end = front_end = Recorder()
    device = usb.core.find(backend=BusBackend(host, HandClock().wait))
    expected, running = [], b""
    for message in sent:
        assert device.write(0x02, message) == len(message)
        running += message
        full = len(message) % speed.packet_bytes == 0
        if full and zero:
            device.write(0x02, b"")
        if not full or zero:
            expected.append(running[:4096])
            running = b""
    assert front_end.got == expected
