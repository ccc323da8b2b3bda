"""The mock RT-DAC/USB as a USB device: an FTDI bridge between the bus and the FPGA's byte stream.

The real board's chip is UNKNOWN; this one is an FT232R, so that the kernel's `ftdi_sio` makes a serial port of it.
Source: docs/facts/usb.md#ftdi-chip.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Final

from inteco_abs.mock_board.frontend import Stream
from inteco_abs.mock_board.usbip.usb_descriptors import MOCK_SERIALS, UsbIdentity, UsbSpeed
from inteco_abs.mock_board.usbip.usb_device import Handshake, SetupPacket, UsbAnswer, UsbDevice

ENDPOINT_IN, ENDPOINT_OUT = 0x81, 0x02
_STATUS: Final = bytes((0x31, 0x60))
"""First bytes of each packet: clear to send, data set ready, transmitter empty."""
_MOST_DATA: Final = UsbSpeed.FULL.packet_bytes - len(_STATUS)
_MOST_UNREAD: Final = 4096
"""Bytes that wait for the host. A real chip holds some hundred; its FPGA's reaction to a full chip is UNKNOWN."""
_RESET_LATENCY_MS: Final = 16

_TO_DEVICE, _FROM_DEVICE = 0x40, 0xC0
_RESET, _EVENT_CHARACTER, _SET_LATENCY = 0, 6, 9
_IGNORED: Final = {1, 2, 3, 4, 7, 0x0B}
"""Modem control, flow control, baud rate divisor, line format, error character, bit mode: without effect in a FIFO."""
_RESET_ALL, _DROP_UNREAD = 0, 1
_ENABLED: Final = 0x100
_GET_LATENCY: Final = 10
_ANSWERS: Final = {5: _STATUS, 0x0C: b"\0", 0x90: b"\xff\xff"}
"""Modem status, pins, and a word of the blank EEPROM."""


def ftdi_identity(serial: int = MOCK_SERIALS.start + 1) -> UsbIdentity:
    """Return an FT232R's ids and strings with a mock's serial number; raises ValueError for any other number."""
    return UsbIdentity(
        serial,
        0x0403,
        0x6001,
        UsbSpeed.FULL,
        "FTDI",
        "FT232R USB UART",
        0x0600,
        (0, 0, 0),
        (0xFF, 0xFF, 0xFF),
        (ENDPOINT_IN, ENDPOINT_OUT),
    )


class FtdiBoard(UsbDevice):
    """A board whose FPGA is `stream`; `now_ns` is the clock of the latency timer.

    A packet is ready for the host when it is full, when the event character waits, or when the timer, which starts with
    each packet, has expired: then with the waiting bytes, or the status alone.
    """

    def __init__(
        self, stream: Stream, identity: UsbIdentity | None = None, now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        super().__init__(identity or ftdi_identity())
        self.stream = stream
        self.latency_ms = _RESET_LATENCY_MS
        self.lost_answers = 0
        """Answers lost in a full buffer."""
        self._now_ns = now_ns
        self._unread = bytearray()
        self._event: int | None = None  # the event character, if it is enabled
        self._due_ns = now_ns()
        self._awaited = False

    @property
    def due_s(self) -> float:
        """Time until the latency timer expires, s; infinite if no host waits for it."""
        return max(0, self._due_ns - self._now_ns()) * 1e-9 if self._awaited else math.inf

    def reset(self) -> None:
        """Reset the bus; the latency timer keeps its setting."""
        super().reset()
        self._unread.clear()
        self._awaited = False

    def catch_up(self) -> None:
        """Advance the rig."""
        self._awaited = False  # a waiting host asks again at once; one that has closed the port does not
        self.stream.front_end.device.catch_up()

    def packet_in(self, endpoint: int) -> UsbAnswer:
        """Return a packet of status and the oldest bytes, NAK or STALL."""
        if endpoint in self._halted:
            return Handshake.STALL
        now = self._now_ns()
        urgent = len(self._unread) >= _MOST_DATA or (self._event is not None and self._event in self._unread)
        if not urgent and now < self._due_ns:
            self._awaited = True
            return Handshake.NAK
        self._awaited = False
        self._due_ns = now + self.latency_ms * 1_000_000
        packet = _STATUS + self._unread[:_MOST_DATA]
        del self._unread[:_MOST_DATA]
        return packet

    def _arrive(self, packet: bytes) -> None:
        """Pass on every packet, as a byte stream has no messages."""
        self._receive(packet)

    def _receive(self, message: bytes) -> None:
        answer = self.stream.feed(message)
        if len(self._unread) + len(answer) > _MOST_UNREAD:
            self.lost_answers += 1
        else:
            self._unread += answer
        self.on_ready()

    def _vendor(self, setup: SetupPacket, data: bytes) -> UsbAnswer:
        if setup.request_type == _FROM_DEVICE:
            if setup.request == _GET_LATENCY:
                return bytes((self.latency_ms,))
            return _ANSWERS.get(setup.request, Handshake.STALL)
        if setup.request_type != _TO_DEVICE or data:
            return Handshake.STALL
        return self._set(setup.request, setup.value)

    def _set(self, request: int, value: int) -> Handshake:
        if request == _RESET and value in {_RESET_ALL, _DROP_UNREAD}:
            self._unread.clear()
        elif request == _SET_LATENCY and 1 <= value <= 0xFF:
            self.latency_ms = value
        elif request == _EVENT_CHARACTER:
            self._event = value & 0xFF if value & _ENABLED else None
        elif request not in _IGNORED and request != _RESET:
            return Handshake.STALL
        return Handshake.ACK
