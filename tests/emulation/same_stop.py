"""One whole stop in virtual time, the board reached in one of several ways: the ticks must be the same.

Device and driver share the clock, so everything between them is in this process, too. For real libusb it is started
with umockdev's preload library: `python same_stop.py LINK OUT SEED [SETTING...]` writes the packed ticks to OUT.
"""

import os
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

from pyusb_backend import BusBackend
from usbfs import UsbfsTree
from usbip_client import UsbIpBus

from inteco_abs.boards import InProcessLink, board_behind
from inteco_abs.boards.transports.usb import UsbLink
from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline
from inteco_abs.format import TICK, pack_tick
from inteco_abs.mock_board import Device, TcpAddress, UsbBoard, UsbHost, UsbIpServer, front_end_of
from inteco_abs.realtime import Loop, StopFlag, TickRing, VirtualClock

TIMEOUT_MS = 10_000
"""A busy computer must not make an answer late: that would be another stop."""
_MOST_TICKS = 60_000


@contextmanager
def in_process(front_end, _ids):
    yield InProcessLink(front_end)


@contextmanager
def over_pyusb(front_end, ids):
    yield UsbLink("", ids, BusBackend(UsbHost(UsbBoard(front_end))), TIMEOUT_MS)


@contextmanager
def over_usbip(front_end, ids):
    server = UsbIpServer(UsbHost(UsbBoard(front_end)), TcpAddress(port=0))
    address = tuple(server.bind().address)
    thread = threading.Thread(target=server.serve)
    thread.start()
    bus = UsbIpBus(address)
    try:
        yield UsbLink("", ids, BusBackend(bus), TIMEOUT_MS)
    finally:
        bus.close()
        server.close()
        thread.join(10)


@contextmanager
def _over_libusb(front_end):
    tree = UsbfsTree(UsbHost(UsbBoard(front_end)))
    os.environ["UMOCKDEV_DIR"] = str(tree.path)
    try:
        yield
    finally:
        tree.close()


@contextmanager
def over_libusb(front_end, ids):
    with _over_libusb(front_end):
        yield UsbLink("", ids, timeout_ms=TIMEOUT_MS)


@contextmanager
def over_libusb_queued(front_end, ids):
    from inteco_abs.boards.transports.usb_async import QueuedUsbLink

    with _over_libusb(front_end):
        yield QueuedUsbLink("", ids, TIMEOUT_MS)


LINKS = {
    "in process": in_process,
    "pyusb": over_pyusb,
    "USB/IP": over_usbip,
    "libusb, one by one": over_libusb,
    "libusb, queued": over_libusb_queued,
}


def stop(link, seed, settings=()):
    """Packed ticks of one stop."""
    config = load_config(settings=settings)
    clock = VirtualClock(config.period_ns)
    front_end = front_end_of(Device(config, clock.now_ns, seed))
    ring = TickRing(pack_tick, TICK.size, _MOST_TICKS)
    with LINKS[link](front_end, config.usb) as opened, board_behind(opened, config, clock.now_ns) as board:
        board.hurried = False  # what takes real time takes none of the run's
        Loop(board, build_pipeline(config), clock, ring, StopFlag()).run()
    return ring.reader().take()


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(stop(sys.argv[1], int(sys.argv[3]), sys.argv[4:]))
