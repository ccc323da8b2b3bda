"""The driver on real libusb against a troubled board; both are in this process: `python trouble_client.py ENGINE TASK`.

Started with umockdev's preload library. Prints one JSON object: what went wrong by scenario, null for what went well.
With the task `denied` the device file is another process's.
"""

import json
import os
import signal
import sys
from types import SimpleNamespace

import pytest
import usb.core
from trouble import SCENARIOS, Bench, run_all
from usbfs import UsbfsTree

from firmware_protocol.rtdac_usb2_bridge import VENDOR_ID
from inteco_abs.boards.transports import usb_async as usb_queued
from inteco_abs.boards.transports.usb import UsbLink
from inteco_abs.boards.transports.usb_async import QueuedUsbLink
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError

LINKS = {"one-by-one": UsbLink, "queued": QueuedUsbLink}
TIMEOUT_MS = 400
"""A busy computer must not make an answer late."""


def interrupted_in_mid_exchange(bench):
    def interrupt(*_):
        raise KeyboardInterrupt

    signal.signal(signal.SIGALRM, interrupt)

    def wait_for_an_answer():
        with bench.driving():
            bench.change(lambda *_: b"")
            signal.setitimer(signal.ITIMER_REAL, 0.05)
            bench.exchange()

    with pytest.raises(KeyboardInterrupt):
        wait_for_an_answer()
    assert bench.device.duties == (0.0, 0.0)


def unplugged_while_it_is_opened(bench):
    found = usb_queued.find_usb_board
    usb_queued.find_usb_board = lambda *_: SimpleNamespace(bus=1, address=99)
    try:
        with pytest.raises(BoardError, match="cannot be opened: the board is gone: check cable and power"):
            QueuedUsbLink("", bench.config.usb)
    finally:
        usb_queued.find_usb_board = found
    bench.open_link().close()


def denied(link):
    with pytest.raises(BoardError, match=r"no board that may be opened.*doctor --rules prints the udev rule"):
        link("", UsbConfig())


def main(engine, task):
    link = LINKS[engine]
    if task == "denied":
        denied(link)
        json.dump({"denied": None}, sys.stdout)
        return
    bench = Bench()
    bench.open_link = lambda: link("", bench.config.usb, timeout_ms=TIMEOUT_MS)
    bench.find = lambda: usb.core.find(idVendor=VENDOR_ID)
    tree = UsbfsTree(bench.host, driver="usbtest" if task == "bound" else None)
    os.environ["UMOCKDEV_DIR"] = str(tree.path)
    try:
        if task == "bound":
            bench.open_link().close()  # says so on stderr
            results = {"bound": None}
        else:
            own = {each.__name__: each for each in (interrupted_in_mid_exchange, unplugged_while_it_is_opened)}
            results = run_all(bench, {**SCENARIOS, **own})
    finally:
        tree.close()
    json.dump({**results, "jtag": bench.board.jtag_transfers or None}, sys.stdout)


main(*sys.argv[1:])
