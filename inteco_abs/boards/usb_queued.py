"""USB bulk transfers with all three of a tick in flight at once: libusb's asynchronous calls, over python-libusb1.

One after the other, each transfer of a tick waits for the bus before the next is handed over; queued, the host
controller has them all and the tick waits once (fact sheet on real time, 5.1 and 11: INFERRED to save a third).
"""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any, Final

import usb1

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from inteco_abs.boards.links import Link
from inteco_abs.boards.usb import TIMEOUT_MS, find_one
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError

_AT_ONCE_MS: Final = 1
_MOST_WAITING: Final = 4
_CANCEL_S: Final = 0.1

_WORDS: Final = {
    usb1.TRANSFER_TIMED_OUT: f"the board did not answer within {TIMEOUT_MS} ms",
    usb1.TRANSFER_CANCELLED: f"the board did not answer within {TIMEOUT_MS} ms",
    usb1.TRANSFER_STALL: "the board refused the transfer (stall)",
    usb1.TRANSFER_NO_DEVICE: "the board is gone: check cable and power",
    usb1.TRANSFER_OVERFLOW: "the board sent more than was asked for",
    usb1.TRANSFER_ERROR: "the bus failed: check the cable, avoid hubs",
}


class QueuedUsbLink(Link):
    """The same board as `usb.UsbLink` opens, under the same conditions; raises BoardError as it does."""

    def __init__(self, serial: str, ids: UsbConfig) -> None:
        found = find_one(serial, ids)
        self._context = usb1.USBContext()
        self._context.open()
        try:
            self._handle = self._open(found.bus, found.address)
            self._handle.claimInterface(0)
        except usb1.USBError as error:
            self._context.close()
            raise BoardError(f"the board cannot be opened: {error}") from error
        self._first, self._second, self._answer = (self._handle.getTransfer() for _ in range(3))
        self._stalled = False

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        self._recover()
        self._first.setBulk(ENDPOINT_OUT, bytes(data), timeout=TIMEOUT_MS)
        self._finish(self._first)

    def read(self, length: int) -> bytes:
        """Receive one message."""
        return self._receive(length, TIMEOUT_MS)

    def exchange(self, first: bytes | bytearray, second: bytes, length: int) -> bytes:
        """Send two messages and receive one, all handed over before the first is through."""
        self._recover()
        self._first.setBulk(ENDPOINT_OUT, bytes(first), timeout=TIMEOUT_MS)
        self._second.setBulk(ENDPOINT_OUT, second, timeout=TIMEOUT_MS)
        self._answer.setBulk(ENDPOINT_IN, length, timeout=TIMEOUT_MS)
        self._finish(self._first, self._second, self._answer)
        return bytes(self._answer.getBuffer()[: self._answer.getActualLength()])

    def discard(self, length: int) -> None:
        """Drop what has arrived by now; waits for a millisecond, libusb's least."""
        with suppress(LinkError):
            for _ in range(_MOST_WAITING):
                self._receive(length, _AT_ONCE_MS)

    def close(self) -> None:
        """Give the interface back; may be called twice."""
        with suppress(usb1.USBError):  # it may be gone
            self._handle.releaseInterface(0)
        with suppress(usb1.USBError):
            self._handle.close()
        self._context.close()

    def _open(self, bus: int, address: int) -> Any:
        for device in self._context.getDeviceIterator(skip_on_error=True):
            if (device.getBusNumber(), device.getDeviceAddress()) == (bus, address):
                return device.open()
        raise BoardError("the board was unplugged while it was being opened")

    def _receive(self, length: int, timeout_ms: int) -> bytes:
        self._answer.setBulk(ENDPOINT_IN, length, timeout=timeout_ms)
        self._finish(self._answer)
        return bytes(self._answer.getBuffer()[: self._answer.getActualLength()])

    def _finish(self, *transfers: Any) -> None:
        """Submit the transfers in order and wait for all; raises LinkError with what the first failure means."""
        try:
            for transfer in transfers:
                transfer.submit()
            self._wait(transfers)
        except usb1.USBError as error:
            self._cancel(transfers)
            raise LinkError(f"the transfer was refused: {error}") from error
        for transfer in transfers:
            status = transfer.getStatus()
            if status != usb1.TRANSFER_COMPLETED:
                self._stalled = self._stalled or status == usb1.TRANSFER_STALL
                raise LinkError(_WORDS.get(status, f"the transfer failed with status {status}"))

    def _wait(self, transfers: tuple[Any, ...]) -> None:
        while any(transfer.isSubmitted() for transfer in transfers):
            self._context.handleEventsTimeout(TIMEOUT_MS * 1e-3)

    def _cancel(self, transfers: tuple[Any, ...]) -> None:
        """Call back what is still under way: its memory must not be used again before it has come back."""
        for transfer in transfers:
            with suppress(usb1.USBError):
                transfer.cancel()
        end = time.monotonic() + _CANCEL_S
        while any(transfer.isSubmitted() for transfer in transfers) and time.monotonic() < end:
            with suppress(usb1.USBError):
                self._context.handleEventsTimeout(0.001)

    def _recover(self) -> None:
        """A stalled endpoint stays so until it is told otherwise."""
        if self._stalled:
            try:
                for endpoint in (ENDPOINT_OUT, ENDPOINT_IN):
                    self._handle.clearHalt(endpoint)
            except usb1.USBError as error:
                raise LinkError(f"the board's endpoints stay stalled: {error}") from error
            self._stalled = False
