"""Properties of the drill board on every level of the emulation, checked through a pyusb device.

Each check restores the board's state, except the last one, which unplugs it.
"""

import errno
import math
import time
from dataclasses import dataclass, field

import pytest
import usb.core
import usb.util
from drill import Drill

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from firmware_protocol.rtdac_usb2_bridge import PRODUCT_ID, VENDOR_ID

CHECKS = {}
SHORT_MS = 40
"""Time-out of transfers that must not succeed."""
_PATIENCE_S = 5.0


@dataclass
class Bench:
    """A pyusb device with its configuration set, on a level named `level`, and how to find it again."""

    device: usb.core.Device
    find: object
    packet_bytes: int
    keeps_partial_data: bool = True
    """USB/IP loses what a transfer had received when it is cancelled."""
    round_trips: int = 20
    figures: dict = field(default_factory=dict)

    def drill(self, request, value=0, index=0, data=b""):
        return self.device.ctrl_transfer(0x40, request, value, index, data)

    def echo(self, data, room=None):
        """Write `data` and read as much back."""
        assert self.device.write(ENDPOINT_OUT, data) == len(data)
        return bytes(self.device.read(ENDPOINT_IN, room or len(data) or self.packet_bytes))


def check(function):
    CHECKS[function.__name__] = function
    return function


def fails(number, call, *arguments):
    """Whether `call` raises a USBError with this errno."""
    with pytest.raises(usb.core.USBError) as caught:
        call(*arguments)
    assert caught.value.errno == number
    assert isinstance(caught.value, usb.core.USBTimeoutError) == (number == errno.ETIMEDOUT)
    return True


def pattern(count):
    return bytes((i * 7 + i // 256) & 0xFF for i in range(count))


@check
def ids(bench):
    assert (bench.device.idVendor, bench.device.idProduct) == (VENDOR_ID, PRODUCT_ID)


@check
def strings(bench):
    device = bench.device
    assert device.manufacturer == "InTeCo"
    assert "mock" in device.product
    assert int(device.serial_number) // 100_000_000 == 9


@check
def configuration(bench):
    usb.util.dispose_resources(bench.device)
    bench.device.set_configuration()
    assert bench.device.get_active_configuration().bConfigurationValue == 1


@check
def unknown_configuration(bench):
    usb.util.dispose_resources(bench.device)
    assert fails(errno.ENOENT, bench.device.backend.set_configuration, bench.device._ctx.managed_open(), 7)


@check
def endpoints(bench):
    found = {e.bEndpointAddress: e for e in bench.device.get_active_configuration()[(0, 0)]}
    assert set(found) == {0x02, 0x84, 0x06, 0x88}
    assert {(e.bmAttributes, e.wMaxPacketSize) for e in found.values()} == {(2, bench.packet_bytes)}


@check
def claim(bench):
    usb.util.claim_interface(bench.device, 0)
    usb.util.release_interface(bench.device, 0)


@check
def claim_of_no_interface(bench):
    assert fails(errno.ENOENT, usb.util.claim_interface, bench.device, 5)


@check
def second_handle(bench):
    usb.util.claim_interface(bench.device, 0)
    other = bench.find()
    assert fails(errno.EBUSY, usb.util.claim_interface, other, 0)
    assert fails(errno.EBUSY, other.set_configuration)
    usb.util.release_interface(bench.device, 0)
    usb.util.claim_interface(other, 0)
    usb.util.dispose_resources(other)


@check
def vendor_in(bench):
    addresses = bytes(bench.device.ctrl_transfer(0xC0, 0xD9, 0, 0, 6))
    date = bytes(bench.device.ctrl_transfer(0xC0, 0xDA, int.from_bytes(addresses[2:4], "little"), 0, 32))
    assert len(date) == 32
    assert date[:20:2].decode().replace("-", "").isdigit()


@check
def vendor_in_is_cut(bench):
    bench.drill(Drill.STORE, data=b"0123456789")
    assert bytes(bench.device.ctrl_transfer(0xC0, Drill.RECALL, 0, 0, 4)) == b"0123"
    assert bytes(bench.device.ctrl_transfer(0xC0, Drill.RECALL, 0, 0, 64)) == b"0123456789"


@check
def vendor_out_and_back(bench):
    assert bench.drill(Drill.STORE, data=b"kept") == 4
    assert bytes(bench.device.ctrl_transfer(0xC0, Drill.RECALL, 0, 0, 64)) == b"kept"


@check
def unknown_vendor_request(bench):
    assert fails(errno.EPIPE, bench.device.ctrl_transfer, 0x40, 0x01)
    assert fails(errno.EPIPE, bench.device.ctrl_transfer, 0xC0, 0x01, 0, 0, 8)
    assert bench.device.ctrl_transfer(0x40, 0xDF) == 0, "the next request works again"


@check
def short_packet(bench):
    assert bench.echo(b"hello") == b"hello"
    assert bench.echo(b"hello", room=4 * bench.packet_bytes) == b"hello"


@check
def empty_packet(bench):
    assert bench.echo(b"") == b""


@check
def two_packets_and_a_rest(bench):
    data = pattern(2 * bench.packet_bytes + 5)
    assert bench.echo(data) == data


@check
def sixty_four_kib(bench):
    data = pattern(1 << 16)
    assert bench.echo(data) == data


@check
def time_out_in(bench):
    assert fails(errno.ETIMEDOUT, bench.device.read, ENDPOINT_IN, 64, SHORT_MS)
    assert bench.echo(b"after") == b"after"


@check
def partial_data_then_time_out(bench):
    packet = pattern(bench.packet_bytes)
    bench.drill(Drill.OFFER, data=packet)
    if bench.keeps_partial_data:
        assert bytes(bench.device.read(ENDPOINT_IN, 4 * bench.packet_bytes, SHORT_MS)) == packet
    else:
        assert fails(errno.ETIMEDOUT, bench.device.read, ENDPOINT_IN, 4 * bench.packet_bytes, SHORT_MS)


@check
def time_out_out(bench):
    bench.drill(Drill.HOLD, 1, ENDPOINT_OUT)
    assert fails(errno.ETIMEDOUT, bench.device.write, ENDPOINT_OUT, b"not taken", SHORT_MS)
    bench.drill(Drill.HOLD, 0, ENDPOINT_OUT)
    assert bench.echo(b"taken") == b"taken"


@check
def overflow(bench):
    bench.drill(Drill.OFFER, data=pattern(40))
    assert fails(errno.EOVERFLOW, bench.device.read, ENDPOINT_IN, 10)
    assert bench.echo(b"after") == b"after"


@check
def overflow_in_a_later_packet(bench):
    bench.drill(Drill.OFFER, data=pattern(bench.packet_bytes))
    bench.drill(Drill.OFFER, data=pattern(bench.packet_bytes))
    assert fails(errno.EOVERFLOW, bench.device.read, ENDPOINT_IN, bench.packet_bytes + 10)
    assert bench.echo(b"after") == b"after"


@check
def stall_stays_until_cleared(bench):
    bench.drill(Drill.HALT, 0, ENDPOINT_IN)
    assert fails(errno.EPIPE, bench.device.read, ENDPOINT_IN, 64)
    assert fails(errno.EPIPE, bench.device.read, ENDPOINT_IN, 64)
    assert bytes(bench.device.ctrl_transfer(0x82, 0, 0, ENDPOINT_IN, 2)) == b"\1\0"
    bench.device.clear_halt(ENDPOINT_IN)
    assert bench.echo(b"cleared") == b"cleared"


@check
def stall_out(bench):
    bench.drill(Drill.HALT, 0, ENDPOINT_OUT)
    assert fails(errno.EPIPE, bench.device.write, ENDPOINT_OUT, b"x")
    bench.device.clear_halt(ENDPOINT_OUT)
    assert bench.echo(b"cleared") == b"cleared"


@check
def programming_endpoints_are_refused(bench):
    assert fails(errno.EPIPE, bench.device.write, 0x06, b"x")
    assert fails(errno.EPIPE, bench.device.read, 0x88, 64)


def _bus_error_in(number):
    def bus_error(bench):
        bench.drill(Drill.FAIL, number, ENDPOINT_IN)
        assert fails(errno.EIO, bench.device.read, ENDPOINT_IN, 64)
        assert bench.echo(b"after") == b"after"

    bus_error.__name__ = f"bus_error_in_{errno.errorcode[number]}"
    return bus_error


for _number in (errno.EPROTO, errno.EILSEQ, errno.ETIME):
    check(_bus_error_in(_number))


@check
def bus_error_out(bench):
    bench.drill(Drill.FAIL, errno.EPROTO, ENDPOINT_OUT)
    assert fails(errno.EIO, bench.device.write, ENDPOINT_OUT, b"lost")
    assert bench.echo(b"after") == b"after"


@check
def round_trips(bench):
    """No threshold: shared machines have none to hold."""
    data, times = pattern(bench.packet_bytes - 8), []
    for _ in range(bench.round_trips):
        start = time.perf_counter()
        assert bench.echo(data) == data
        times.append(time.perf_counter() - start)
    times.sort()
    for name, share in (("p50", 0.5), ("p99", 0.99)):
        bench.figures[name] = times[min(math.floor(share * len(times)), len(times) - 1)] * 1e6


@check
def unplug(bench):
    device = bench.device
    bench.echo(b"claimed")
    try:
        bench.drill(Drill.UNPLUG)
    except usb.core.USBError as error:
        assert error.errno == errno.ENODEV  # noqa: PT017 - it may fail, or be gone just after its answer
    deadline = time.monotonic() + _PATIENCE_S
    while bench.find() is not None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert bench.find() is None
    assert fails(errno.ENODEV, device.read, ENDPOINT_IN, 64)
    assert fails(errno.ENODEV, device.write, ENDPOINT_OUT, b"x")
    assert fails(errno.ENODEV, device.ctrl_transfer, 0x40, 0xDF)
    usb.util.dispose_resources(device)
