"""Benches of the check list: the drill board on each level, at both speeds."""

import os
import threading
from contextlib import contextmanager

import pytest
import usb.core
from check_list import Bench
from drill import HandClock, new_host
from pyusb_backend import BusBackend
from usbfs import preload_is_installed
from usbip_client import UsbIpBus

from inteco_abs.mock_board import TcpAddress, UnixAddress, UsbIpServer, UsbSpeed


@contextmanager
def served(host, address=None):
    """A USB/IP server in a thread: the server, and where to connect."""
    server = UsbIpServer(host, address or TcpAddress(port=0))
    place = server.bind().address
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        yield server, place.path if isinstance(place, UnixAddress) else tuple(place)
    finally:
        server.close()
        thread.join(10)
        assert not thread.is_alive()


@contextmanager
def in_process(host, clock):
    yield BusBackend(host, clock.wait)


@contextmanager
def over_usbip(host, _clock):
    with served(host) as (_, address):
        bus = UsbIpBus(address)
        try:
            yield BusBackend(bus)
        finally:
            bus.close()


LEVELS = {"L2": in_process, "L2b": over_usbip}


@pytest.fixture(params=UsbSpeed, ids=lambda speed: speed.name.lower())
def speed(request):
    return request.param


@pytest.fixture(params=LEVELS)
def level(request):
    return request.param


@pytest.fixture
def clock():
    return HandClock()


@pytest.fixture
def bench(level, speed, clock):
    with LEVELS[level](new_host(speed, clock=clock), clock) as backend:

        def find():
            return usb.core.find(backend=backend)

        yield Bench(find(), find, speed.packet_bytes, keeps_partial_data=level != "L2b")


@pytest.fixture
def real_board(level, speed, clock):
    """The mock board itself, as pyusb's device, and the board's own object."""
    host = new_host(speed, drill=False, clock=clock)
    with LEVELS[level](host, clock) as backend:
        yield usb.core.find(backend=backend), host.device


@pytest.fixture(scope="session")
def preload():
    """Umockdev's preload library, without which nothing leads real libusb to an emulated device file."""
    if not preload_is_installed():
        missing = "umockdev's preload library is missing: apt-get install umockdev libusb-1.0-0"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)


@pytest.fixture(scope="session")
def serve():
    return served
