"""The mock RT-DAC/USB behind its FTDI bridge: packets, latency timer and requests, over pyusb and bare."""

import errno

import pytest
import usb.core
from check_list import fails
from drill import HandClock
from hypothesis import given
from hypothesis import strategies as st
from pyusb_backend import BusBackend

from firmware_protocol.rtdac_usb import DUMMY, FRAME_BYTES, READ_REQUEST, decode_read, encode_send
from inteco_abs.boards.families.usb.mock import ByteStream, UsbFrontEnd
from inteco_abs.config import load_config
from inteco_abs.mock_board import Device, FtdiBoard, UsbHost, UsbSpeed
from inteco_abs.mock_board.usbip.usb_device import Handshake, SetupPacket

IN, OUT = 0x81, 0x02
DRIVING = encode_send({"pin_mode": 0b11, "pwm0_width": 255, "pwm3_prescaler": 77}, logic=0x0111)
MS = 1_000_000
STATUS = b"\x31\x60"


class SteppingClock(HandClock):
    """Time-outs pass in steps, so that a device's own timers run in the meantime."""

    host = None

    def wait(self, event, timeout_s):
        end = self.time_ns + round(timeout_s * 1e9)
        while not event.is_set() and self.time_ns < end:
            self.time_ns += MS // 10
            self.host.catch_up()
        return event.is_set()


def new_board(clock):
    return FtdiBoard(ByteStream(UsbFrontEnd(Device(load_config(profile="sim_usb"), clock.now_ns))), now_ns=clock.now_ns)


@pytest.fixture
def clock():
    return SteppingClock()


@pytest.fixture
def board(clock):
    board = new_board(clock)
    board.control(SetupPacket(0, 9, 1, 0, 0))
    return board


@pytest.fixture
def device(board, clock):
    clock.host = UsbHost(board)
    return usb.core.find(backend=BusBackend(clock.host, clock.wait))


def read(device, length):
    """What a driver makes of the packets: their data, without the two bytes before each."""
    data = b""
    while len(data) < length:
        packet = bytes(device.read(IN, 64))
        assert packet[:2] == STATUS
        data += packet[2:]
    return data


def fetched(board):
    """Data of all packets that the board sends at once."""
    data = []
    while isinstance(packet := board.packet_in(IN), bytes):
        assert packet.startswith(STATUS)
        data.append(packet[2:])
    return data


def test_it_calls_itself_an_ft232r_and_a_mock(device):
    assert (device.idVendor, device.idProduct, device.bcdDevice) == (0x0403, 0x6001, 0x0600)
    assert (device.manufacturer, device.product) == ("FTDI", "FT232R USB UART")
    assert device.serial_number == "900000001"
    interface = device.get_active_configuration()[(0, 0)]
    assert [(one.bEndpointAddress, one.wMaxPacketSize) for one in interface] == [(IN, 64), (OUT, 64)]


def test_settings_and_answers_travel_in_packets(device, board):
    device.write(OUT, DUMMY)
    device.write(OUT, DRIVING + READ_REQUEST)
    frame = decode_read(read(device, FRAME_BYTES), logic=0x0111)
    assert (frame["application_name"], frame["pwm0_width"], frame["pwm3_prescaler"]) == ("ABSIM", 255, 77)
    assert board.stream.front_end.device.duties == (1.0, 0.0)
    assert board.stream.front_end.rejected == 0


def test_only_the_end_of_an_answer_waits_for_the_latency_timer(board, clock):
    fetched(board)
    clock.time_ns += 20 * MS
    assert fetched(board) == [b""]
    board.packet_out(OUT, READ_REQUEST)
    assert [len(data) for data in fetched(board)] == [62, 62]
    clock.time_ns += 16 * MS - 1
    assert board.packet_in(IN) is Handshake.NAK
    clock.time_ns += 1
    assert [len(data) for data in fetched(board)] == [26]


@pytest.mark.parametrize("latency_ms", [1, 2, 16, 255])
def test_without_data_the_status_comes_each_time_that_the_timer_runs_out(board, clock, latency_ms):
    assert board.control(SetupPacket(0x40, 9, latency_ms, 0, 0)) is Handshake.ACK
    assert board.control(SetupPacket(0xC0, 10, 0, 0, 1)) == bytes([latency_ms])
    fetched(board)
    packets, start_ns = 0, clock.time_ns
    while packets < 5:
        clock.time_ns += MS // 4
        packets += len(fetched(board))
    assert clock.time_ns - start_ns == 5 * latency_ms * MS


def test_it_says_when_to_ask_again(board, clock):
    fetched(board)
    assert board.due_s == 0.016
    clock.time_ns += 10 * MS
    assert board.due_s == pytest.approx(0.006)
    clock.time_ns += 10 * MS
    assert board.due_s == 0.0
    board.reset()
    assert board.due_s > 1e9


def test_a_host_that_has_closed_the_port_is_not_waited_for(device, board, clock):
    """Its read was taken back. A server that went on being patient for no time at all would never sleep again."""
    device.ctrl_transfer(0x40, 9, 255, 0)
    assert bytes(device.read(IN, 64)) == STATUS
    assert fails(errno.ETIMEDOUT, device.read, IN, 64, 10)
    clock.time_ns += 300 * MS
    clock.host.catch_up()
    assert board.due_s > 1e9


@pytest.mark.parametrize(("latency_ms", "most_ms"), [(16, 17), (1, 2)])
def test_a_reading_takes_as_long_as_the_timer_has_it(device, clock, latency_ms, most_ms):
    device.ctrl_transfer(0x40, 9, latency_ms, 0)
    for _ in range(3):
        start_ns = clock.time_ns
        device.write(OUT, READ_REQUEST)
        read(device, FRAME_BYTES)
        assert latency_ms - 1 < (clock.time_ns - start_ns) / MS <= most_ms


def test_the_event_character_sends_what_waits_at_once(board):
    fetched(board)
    board.packet_out(OUT, READ_REQUEST)
    assert len(fetched(board)) == 2
    board.control(SetupPacket(0x40, 6, 0x100, 0, 0))  # a zero, of which the end of the answer has many
    assert len(fetched(board)) == 1


@pytest.mark.parametrize(("value", "left"), [(0, 0), (1, 0), (2, 150)])
def test_a_reset_or_purge_drops_what_was_not_fetched(board, clock, value, left):
    board.packet_out(OUT, READ_REQUEST)
    assert board.control(SetupPacket(0x40, 0, value, 0, 0)) is Handshake.ACK
    received = b""
    for _ in range(4):
        clock.time_ns += 16 * MS
        received += b"".join(fetched(board))
    assert len(received) == left


def test_line_settings_are_taken_and_change_nothing(device):
    for request in (1, 2, 3, 4, 7, 0x0B):
        device.ctrl_transfer(0x40, request, 0x1234, 0)
    device.write(OUT, READ_REQUEST)
    assert len(read(device, FRAME_BYTES)) == FRAME_BYTES


def test_other_requests_are_answered_or_stall(device):
    assert bytes(device.ctrl_transfer(0xC0, 5, 0, 0, 2)) == STATUS
    assert bytes(device.ctrl_transfer(0xC0, 0x90, 0, 3, 2)) == b"\xff\xff"
    assert fails(errno.EPIPE, device.ctrl_transfer, 0xC0, 0x77, 0, 0, 2)
    assert fails(errno.EPIPE, device.ctrl_transfer, 0x40, 0x77, 0, 0)
    assert fails(errno.EPIPE, device.ctrl_transfer, 0x40, 9, 0, 0)


def test_answers_that_the_host_does_not_fetch_do_not_fill_the_memory(board):
    for _ in range(100):
        board.packet_out(OUT, READ_REQUEST)
    assert board.lost_answers == 100 - 4096 // FRAME_BYTES


def test_a_halted_endpoint_stalls_until_it_is_cleared(board):
    for endpoint in (IN, OUT):
        board.control(SetupPacket(0x02, 3, 0, endpoint, 0))
    assert board.packet_in(IN) is board.packet_out(OUT, b"") is Handshake.STALL
    for endpoint in (IN, OUT):
        board.control(SetupPacket(0x02, 1, 0, endpoint, 0))
    assert board.packet_out(OUT, READ_REQUEST) is Handshake.ACK


def test_a_bus_reset_leaves_outputs_and_timer_alone(board):
    board.control(SetupPacket(0x40, 9, 3, 0, 0))
    for at in range(0, FRAME_BYTES, 64):
        board.packet_out(OUT, DRIVING[at : at + 64])
    board.packet_out(OUT, READ_REQUEST)
    board.reset()
    assert board.endpoints == ()
    assert board.stream.front_end.device.duties == (1.0, 0.0)
    assert board.latency_ms == 3


@given(cuts=st.lists(st.integers(0, 64), max_size=40))
def test_the_cuts_of_the_packets_do_not_matter(cuts):
    clock, stream = HandClock(), READ_REQUEST + DRIVING + READ_REQUEST
    board, twin = new_board(clock), UsbFrontEnd(Device(load_config(profile="sim_usb"), clock.now_ns))
    for cut in [*cuts, *[UsbSpeed.FULL.packet_bytes] * 3]:
        board.packet_out(OUT, stream[:cut])
        stream = stream[cut:]
    expected = b""
    for message in (READ_REQUEST, DRIVING, READ_REQUEST):
        twin.bulk_out(message)
        expected += twin.bulk_in(FRAME_BYTES)
    received = b""
    while len(received) < len(expected):
        clock.time_ns += 16 * MS
        received += b"".join(fetched(board))
    assert received == expected
