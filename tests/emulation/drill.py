"""The mock board with a firmware for drills: echoes packets, and makes trouble when vendor requests ask for it.

Ids, descriptors, standard requests and packet rules are the product's own; only what lies behind the endpoints
differs, so that one check list finds the same device on every level. The requests lie outside the board's range.
"""

import time
from enum import IntEnum

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.config import load_config
from inteco_abs.mock_board import Device, UsbBoard, UsbHost, UsbIdentity
from inteco_abs.mock_board.usbip.usb_device import Handshake


class Drill(IntEnum):
    """Vendor requests OUT (0x40), except for RECALL."""

    HALT = 0x70  # wIndex: endpoint
    HOLD = 0x71  # wIndex: endpoint, wValue: 1 answers NAK, 0 works again
    UNPLUG = 0x72
    OFFER = 0x73  # data: one IN packet of any length
    FAIL = 0x74  # wIndex: endpoint, wValue: errno that its next transfer ends with
    STORE = 0x75  # data: kept
    RECALL = 0x76  # IN (0xC0): what was kept


class DrillBoard(UsbBoard):
    def __init__(self, front_end, identity):
        super().__init__(front_end, identity)
        self.host = None
        self._held = set()
        self._kept = b""

    def reset(self):
        super().reset()
        self._held.clear()

    def packet_in(self, endpoint):
        return Handshake.NAK if endpoint in self._held else super().packet_in(endpoint)

    def packet_out(self, endpoint, packet):
        if endpoint in self._held:
            return Handshake.NAK
        if endpoint == ENDPOINT_OUT and endpoint not in self._halted:
            self._queue(ENDPOINT_IN, [packet])
            return Handshake.ACK
        return super().packet_out(endpoint, packet)

    def _vendor(self, setup, data):
        match setup.request:
            case Drill.HALT:
                self._halted.add(setup.index)
            case Drill.HOLD:
                (self._held.add if setup.value else self._held.discard)(setup.index)
                self.on_ready()
            case Drill.UNPLUG:
                self.host.unplug()
            case Drill.OFFER:
                self._queue(ENDPOINT_IN, [data])
            case Drill.FAIL:
                self.host.inject(setup.index, -setup.value)
            case Drill.STORE:
                self._kept = data
            case Drill.RECALL:
                return self._kept
            case _:
                return super()._vendor(setup, data)
        return Handshake.ACK


class HandClock:
    """Time that moves only when a test moves it, or a time-out passes."""

    def __init__(self):
        self.time_ns = 1_000_000_000

    def now_ns(self):
        return self.time_ns

    def wait(self, event, timeout_s):
        """Let time pass instead of waiting: nothing but the caller moves on this bus."""
        if not event.is_set():
            assert timeout_s is not None, "this would wait for ever"
            self.time_ns += round(timeout_s * 1e9)
        return event.is_set()


def new_front_end(clock=None):
    return Usb2FrontEnd(Device(load_config(), (clock or HandClock()).now_ns))


def new_host(speed, *, drill=True, clock=None, **identity):
    """A host with the drill board, or with the product's own, plugged in."""
    board = (DrillBoard if drill else UsbBoard)(new_front_end(clock), UsbIdentity(speed=speed, **identity))
    host = UsbHost(board)
    board.host = host
    return host


def eventually(condition):
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)
