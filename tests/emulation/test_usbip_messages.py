"""The USB/IP server's bytes, on raw sockets and written out by hand."""

import errno
import struct
import threading
import time
from contextlib import suppress
from typing import ClassVar

import pytest
from drill import Drill, eventually, new_host
from usbip_client import UsbIpBus, connect, receive

from inteco_abs.mock_board import UnixAddress, UsbSpeed

RECORD = (
    b"/sys/devices/inteco-abs-mock/usb1/1-1".ljust(256, b"\0")
    + b"1-1".ljust(32, b"\0")
    + bytes.fromhex("00000001 00000002 00000003 04b4 8613 0100 ff 00 00 00 01 01")
)
ASK_DEVICES = bytes.fromhex("0111 8005 00000000")
ASK_IMPORT = bytes.fromhex("0111 8003 00000000") + b"1-1".ljust(32, b"\0")
REFUSED = bytes.fromhex("0111 0003 00000001")
DEVICE_ID = 0x00010002
IN, OUT = 1, 0
NOT_ISOCHRONOUS = 0xFFFFFFFF


def submit(sequence, direction, endpoint, length, data=b"", setup=bytes(8), flags=0, device=DEVICE_ID, packets=0):
    return (
        struct.pack(">IIIIIIiiII8s", 1, sequence, device, direction, endpoint, flags, length, 0, packets, 0, setup)
        + data
    )


def unlink(sequence, victim):
    return struct.pack(">IIIIII24x", 2, sequence, DEVICE_ID, 0, 0, victim)


def returned(sequence, status, actual, data=b""):
    return struct.pack(">IIIIIiiiII8x", 3, sequence, 0, 0, 0, status, actual, 0, NOT_ISOCHRONOUS, 0) + data


def unlinked(sequence, status):
    return struct.pack(">IIIIIi24x", 4, sequence, 0, 0, 0, status)


def drill(sequence, request, value=0, index=0, data=b""):
    return submit(sequence, OUT, 0, len(data), data, struct.pack("<BBHHH", 0x40, request, value, index, len(data)))


CONFIGURE = bytes((0, 9, 1, 0, 0, 0, 0, 0))


class Peer:
    """A raw stream to the server."""

    streams: ClassVar = []

    def __init__(self, address):
        self.stream = connect(address)
        self.streams.append(self.stream)

    def ask(self, data, answer):
        """Send `data` and expect exactly `answer`, byte for byte."""
        self.stream.sendall(data)
        self.expect(answer)

    def expect(self, answer):
        assert receive(self.stream, len(answer)).hex() == answer.hex()

    def expect_end(self):
        with suppress(ConnectionResetError):
            assert self.stream.recv(1) == b""

    def take(self):
        self.ask(ASK_IMPORT, bytes.fromhex("0111 0003 00000000") + RECORD)
        self.ask(submit(1, OUT, 0, 0, setup=CONFIGURE), returned(1, 0, 0))
        return self


@pytest.fixture
def host():
    return new_host(UsbSpeed.HIGH)


@pytest.fixture
def server(serve, host):
    with serve(host) as (server, address):
        server.address = address
        yield server


@pytest.fixture(autouse=True)
def hang_up():
    yield
    while Peer.streams:
        Peer.streams.pop().close()


@pytest.fixture
def peer(server):
    return Peer(server.address)


@pytest.fixture
def attached(peer):
    return peer.take()


def test_devices(peer):
    answer = bytes.fromhex("0111 0005 00000000 00000001") + RECORD + bytes.fromhex("ff 00 00 00")
    peer.ask(ASK_DEVICES, answer)
    peer.expect_end()
    assert len(RECORD) == 312


def test_devices_at_full_speed(serve):
    with serve(new_host(UsbSpeed.FULL, serial=923_456_789, vendor_id=0x1234, product_id=0xABCD)) as (_, address):
        peer = Peer(address)
        record = RECORD.replace(bytes.fromhex("00000003 04b4 8613"), bytes.fromhex("00000002 1234 abcd"))
        peer.ask(ASK_DEVICES, bytes.fromhex("0111 0005 00000000 00000001") + record + bytes.fromhex("ff000000"))


def test_no_device_while_unplugged(peer, host):
    host.unplug()
    peer.ask(ASK_DEVICES, bytes.fromhex("0111 0005 00000000 00000000"))


def test_import_and_a_control_transfer(attached):
    attached.ask(submit(2, IN, 0, 18, setup=bytes.fromhex("80 06 0001 0000 1200")), returned(2, 0, 18, bytes.fromhex(
        "12 01 0002 ff 00 00 40 b404 1386 0001 01 02 03 01"
    )))  # fmt: skip


def test_import_byte_by_byte(peer):
    for byte in ASK_IMPORT + submit(1, OUT, 0, 0, setup=CONFIGURE):
        peer.stream.sendall(bytes((byte,)))
    peer.expect(bytes.fromhex("0111 0003 00000000") + RECORD + returned(1, 0, 0))


def test_bulk_echo_and_actual_lengths(attached):
    attached.ask(submit(2, OUT, 2, 5, b"hello"), returned(2, 0, 5))
    attached.ask(submit(3, IN, 4, 512), returned(3, 0, 5, b"hello"))


def test_not_isochronous_may_be_said_in_two_ways(attached):
    attached.ask(submit(2, OUT, 2, 1, b"x", packets=NOT_ISOCHRONOUS), returned(2, 0, 1))


def test_zero_packet_flag(attached):
    attached.ask(submit(2, OUT, 2, 512, bytes(512), flags=0x40), returned(2, 0, 512))
    attached.ask(submit(3, IN, 4, 512), returned(3, 0, 512, bytes(512)))
    attached.ask(submit(4, IN, 4, 512), returned(4, 0, 0))


def test_short_not_ok_flag(attached):
    attached.ask(submit(2, OUT, 2, 3, b"abc"), returned(2, 0, 3))
    attached.ask(submit(3, IN, 4, 512, flags=0x01), returned(3, -errno.EREMOTEIO, 3, b"abc"))


def test_overflow_sends_no_more_than_asked_for(attached):
    attached.ask(submit(2, OUT, 2, 9, b"too large"), returned(2, 0, 9))
    attached.ask(submit(3, IN, 4, 4), returned(3, -errno.EOVERFLOW, 4, b"too "))


def test_stall_and_unknown_endpoint(attached):
    attached.ask(submit(2, IN, 8, 64), returned(2, -errno.EPIPE, 0))
    attached.ask(submit(3, IN, 5, 64), returned(3, -errno.ENOENT, 0))


def test_a_data_stage_against_the_setup_is_answered_without_data(attached):
    attached.ask(submit(2, OUT, 0, 0, setup=bytes.fromhex("80 06 0001 0000 1200")), returned(2, -errno.EOVERFLOW, 0))
    attached.ask(submit(3, OUT, 2, 1, b"x"), returned(3, 0, 1))


def test_waiting_read_does_not_delay_others(attached):
    attached.stream.sendall(submit(2, IN, 4, 64))
    attached.ask(submit(3, IN, 0, 1, setup=bytes.fromhex("80 08 0000 0000 0100")), returned(3, 0, 1, b"\1"))
    attached.ask(submit(4, OUT, 2, 2, b"hi"), returned(4, 0, 2) + returned(2, 0, 2, b"hi"))


def test_unlink_in_time_and_nothing_more_of_it(attached):
    attached.stream.sendall(submit(2, IN, 4, 64))
    attached.ask(unlink(3, 2), unlinked(3, -errno.ECONNRESET))
    attached.ask(submit(4, OUT, 2, 2, b"hi"), returned(4, 0, 2))
    attached.ask(submit(5, IN, 4, 64), returned(5, 0, 2, b"hi"))


def test_an_unlink_after_completion_is_answered(attached):
    attached.ask(
        submit(2, OUT, 2, 2, b"hi") + unlink(3, 2) + unlink(4, 77),
        returned(2, 0, 2) + unlinked(3, 0) + unlinked(4, 0),
    )


def test_sequence_number_of_an_unlinked_transfer_is_free_again(attached):
    attached.stream.sendall(submit(2, IN, 4, 64))
    attached.ask(unlink(3, 2), unlinked(3, -errno.ECONNRESET))
    attached.ask(submit(2, OUT, 2, 2, b"hi"), returned(2, 0, 2))


def test_unlinks_racing_with_answers(attached, host):
    """Each transfer is answered once, by one of the two; never by both and never out of order."""
    count = 300

    def feed():
        for _ in range(count):
            with host._lock:
                host.device._queue(0x84, [b"x"])

    feeder = threading.Thread(target=feed)
    feeder.start()
    ended = {}
    for i in range(count):
        victim = 10 + 2 * i
        attached.stream.sendall(submit(victim, IN, 4, 64) + unlink(victim + 1, victim))
        command, sequence, status, actual = struct.unpack(">II12xii20x", receive(attached.stream, 48))
        if command == 3:
            assert (sequence, status, receive(attached.stream, actual)) == (victim, 0, b"x")
            attached.expect(unlinked(victim + 1, 0))
        else:
            assert (command, sequence, status) == (4, victim + 1, -errno.ECONNRESET)
        ended[victim] = command
    feeder.join()
    assert len(ended) == count


def test_second_import_is_refused_and_the_first_continues(attached, server):
    other = Peer(server.address)
    other.ask(ASK_IMPORT, REFUSED)
    other.expect_end()
    attached.ask(submit(2, OUT, 2, 2, b"hi"), returned(2, 0, 2))


@pytest.mark.usefixtures("attached")
def test_devices_while_imported(server):
    other = Peer(server.address)
    other.stream.sendall(ASK_DEVICES)
    assert len(receive(other.stream, 1000)) == 12 + 312 + 4


def test_unknown_bus_id(peer):
    peer.ask(bytes.fromhex("0111 8003 00000000") + b"9-9".ljust(32, b"\0"), REFUSED)
    peer.expect_end()


def test_import_of_an_unplugged_board(peer, host):
    host.unplug()
    peer.ask(ASK_IMPORT, REFUSED)


MALFORMED = {
    "noise": b"GET / HTTP/1.1\r\n\r\n",
    "wrong version": bytes.fromhex("0106 8005 00000000"),
    "a reply": bytes.fromhex("0111 0005 00000000"),
}
MALFORMED_COMMANDS = {
    "unknown command": struct.pack(">I44x", 7),
    "wrong device": submit(2, IN, 4, 64, device=0x00010003),
    "negative length": submit(2, IN, 4, -1),
    "enormous length": submit(2, OUT, 2, 0x7FFFFFFF),
    "isochronous": submit(2, IN, 4, 64, packets=8),
    "unknown direction": submit(2, 2, 4, 64),
    "endpoint out of range": submit(2, IN, 16, 64),
    "sequence number in use": submit(2, IN, 4, 64) + submit(2, IN, 4, 64),
    "noise": bytes(range(256)),
}


@pytest.mark.parametrize("kind", MALFORMED)
def test_malformed_request_ends_the_connection_alone(peer, server, kind):
    peer.stream.sendall(MALFORMED[kind])
    peer.expect_end()
    assert server.malformed == 1
    Peer(server.address).take()


@pytest.mark.parametrize("kind", MALFORMED_COMMANDS)
def test_malformed_command_ends_the_import_alone(attached, server, kind):
    attached.stream.sendall(MALFORMED_COMMANDS[kind])
    attached.expect_end()
    assert server.malformed == 1
    Peer(server.address).take()


def test_more_transfers_than_any_kernel_has(attached, server):
    attached.stream.sendall(b"".join(submit(2 + i, IN, 4, 64) for i in range(300)))
    attached.expect_end()
    Peer(server.address).take()


TRUNCATED = {
    "nothing": b"",
    "half a header": ASK_IMPORT[:3],
    "half a bus id": ASK_IMPORT[:20],
    "half a command": ASK_IMPORT + submit(2, IN, 4, 64)[:30],
    "half the data": ASK_IMPORT + submit(2, OUT, 2, 100, bytes(50)),
    "a waiting transfer": ASK_IMPORT + submit(1, OUT, 0, 0, setup=CONFIGURE) + submit(2, IN, 4, 64),
}


@pytest.mark.parametrize("kind", TRUNCATED)
def test_disconnect_in_the_middle(peer, server, host, kind):
    peer.stream.sendall(TRUNCATED[kind])
    time.sleep(0.02)
    peer.stream.close()
    eventually(lambda: not server.busy)
    Peer(server.address).take()
    assert not any(host._queues.values())


def test_a_second_import_finds_a_newly_plugged_board(serve, host):
    with serve(host) as (server, address):
        first = Peer(address).take()
        first.ask(drill(2, Drill.HALT, 0, 0x84), returned(2, 0, 0))
        first.stream.close()
        eventually(lambda: not server.busy)
        second = Peer(address)
        second.ask(ASK_IMPORT, bytes.fromhex("0111 0003 00000000") + RECORD)
        ask_configuration = submit(1, IN, 0, 1, setup=bytes.fromhex("80 08 0000 0000 0100"))
        second.ask(ask_configuration, returned(1, 0, 1, b"\0"))
        second.ask(submit(2, OUT, 0, 0, setup=CONFIGURE), returned(2, 0, 0))
        second.ask(submit(3, OUT, 2, 2, b"hi") + submit(4, IN, 4, 64), returned(3, 0, 2) + returned(4, 0, 2, b"hi"))


def test_unplug_ends_the_import_and_a_new_board_may_be_imported(attached, server, host):
    attached.stream.sendall(submit(2, IN, 4, 64))
    host.unplug()
    attached.stream.settimeout(5)
    while attached.stream.recv(64):
        pass  # the kernel may get answers before the end
    eventually(lambda: not server.busy)
    host.plug()
    again = Peer(server.address)
    again.stream.sendall(ASK_IMPORT)
    assert receive(again.stream, 320)[8 + 288 : 8 + 296] == bytes.fromhex("00000001 00000003")


def test_unix_socket(serve, host, tmp_path):
    path = tmp_path / "usbip"
    with serve(host, UnixAddress(path)) as (server, address):
        Peer(address).take()
        assert server.facts.attach == ()
    assert not path.exists()


def test_large_transfers_both_ways(server):
    bus = UsbIpBus(server.address)
    bus.close()
    eventually(lambda: not server.busy)
    peer = Peer(server.address).take()
    data = bytes(range(256)) * 4096
    peer.ask(submit(2, OUT, 2, len(data), data), returned(2, 0, len(data)))
    peer.ask(submit(3, IN, 4, len(data)), returned(3, 0, len(data), data))


@pytest.mark.untraced
def test_silent_clients_are_disconnected(serve, host, monkeypatch):
    monkeypatch.setattr("inteco_abs.mock_board.usbip.server._REQUEST_TIMEOUT_S", 0.05)
    with serve(host) as (_, address):
        for _ in range(20):
            Peer(address)
        Peer(address).expect_end()
        time.sleep(0.1)
        Peer(address).take()


def test_closing_is_an_unplug(serve, host):
    with serve(host) as (_, address):
        peer = Peer(address).take()
    peer.expect_end()


def test_a_peer_that_does_not_read_is_disconnected(attached, server, monkeypatch):
    monkeypatch.setattr("inteco_abs.mock_board.usbip.connection._MOST_UNSENT", 1 << 16)
    data = bytes(1 << 20)
    with suppress(OSError):
        for i in range(64):
            attached.stream.sendall(submit(2 * i, OUT, 2, len(data), data) + submit(2 * i + 1, IN, 4, len(data)))
    eventually(lambda: not server.busy)
    Peer(server.address).take()
