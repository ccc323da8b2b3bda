"""USB bulk transfers with all three of a tick in flight at once: libusb's asynchronous calls, over python-libusb1.

One after the other, each transfer of a tick waits for the bus before the next is handed over; queued, the host
controller has them all and the tick waits once (fact sheet on real time, 5.1 and 11: INFERRED to save a third).
"""

from __future__ import annotations

import errno
import time
from contextlib import suppress
from typing import Any, Final

import usb1

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from inteco_abs.boards.links import Link
from inteco_abs.boards.usb import INTERFACE, find_one
from inteco_abs.boards.usb_words import AT_ONCE_MS, TIMEOUT_MS, in_words
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError

_CANCEL_S: Final = 0.1

_STATUS: Final = {
    usb1.TRANSFER_ERROR: errno.EIO,
    usb1.TRANSFER_TIMED_OUT: errno.ETIMEDOUT,
    usb1.TRANSFER_CANCELLED: errno.ETIMEDOUT,
    usb1.TRANSFER_STALL: errno.EPIPE,
    usb1.TRANSFER_NO_DEVICE: errno.ENODEV,
    usb1.TRANSFER_OVERFLOW: errno.EOVERFLOW,
}
"""How a transfer ended, as pyusb would number it."""
_REFUSED: Final = {
    usb1.ERROR_IO: errno.EIO,
    usb1.ERROR_ACCESS: errno.EACCES,
    usb1.ERROR_NO_DEVICE: errno.ENODEV,
    usb1.ERROR_BUSY: errno.EBUSY,
    usb1.ERROR_TIMEOUT: errno.ETIMEDOUT,
    usb1.ERROR_PIPE: errno.EPIPE,
    usb1.ERROR_OVERFLOW: errno.EOVERFLOW,
}
"""Why libusb refused a call, likewise."""


class QueuedUsbLink(Link):
    """The same board as `usb.UsbLink` opens, under the same conditions; raises BoardError as it does."""

    def __init__(self, serial: str, ids: UsbConfig, timeout_ms: int = TIMEOUT_MS) -> None:
        found = find_one(serial, ids)
        self._context = usb1.USBContext()
        self._context.open()
        try:
            self._handle = self._open(found.bus, found.address)
            self._handle.claimInterface(INTERFACE)
        except usb1.USBError as error:
            self._context.close()
            raise BoardError(f"the board cannot be opened: {_in_words(error)}") from error
        self._first, self._second, self._answer = (self._handle.getTransfer() for _ in range(3))
        self._timeout_ms = timeout_ms
        self._stalled = False

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        self._recover()
        self._first.setBulk(ENDPOINT_OUT, bytes(data), timeout=self._timeout_ms)
        self._finish(self._first)

    def read(self, length: int) -> bytes:
        """Receive one message."""
        return self._receive(length, self._timeout_ms)

    def exchange(self, first: bytes | bytearray, second: bytes, length: int) -> bytes:
        """Send two messages and receive one, all handed over before the first is through."""
        self._recover()
        self._first.setBulk(ENDPOINT_OUT, bytes(first), timeout=self._timeout_ms)
        self._second.setBulk(ENDPOINT_OUT, second, timeout=self._timeout_ms)
        self._answer.setBulk(ENDPOINT_IN, length, timeout=self._timeout_ms)
        self._finish(self._first, self._second, self._answer)
        return bytes(self._answer.getBuffer()[: self._answer.getActualLength()])

    def close(self) -> None:
        """Give the interface back; may be called twice."""
        with suppress(usb1.USBError):  # it may be gone
            self._handle.releaseInterface(INTERFACE)
        with suppress(usb1.USBError):
            self._handle.close()
        self._context.close()

    def _open(self, bus: int, address: int) -> Any:
        for device in self._context.getDeviceIterator(skip_on_error=True):
            if (device.getBusNumber(), device.getDeviceAddress()) == (bus, address):
                return device.open()
        raise usb1.USBErrorNoDevice  # unplugged meanwhile

    def _read_waiting(self, length: int) -> bytes:
        return self._receive(length, AT_ONCE_MS)

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
        except BaseException as error:
            self._cancel(transfers)  # also after Ctrl-C: what leaves SAFE behind needs them again
            if isinstance(error, usb1.USBError):
                raise LinkError(_in_words(error)) from error
            raise
        for transfer in transfers:
            status = transfer.getStatus()
            if status != usb1.TRANSFER_COMPLETED:
                self._stalled = self._stalled or any(each.getStatus() == usb1.TRANSFER_STALL for each in transfers)
                raise LinkError(in_words(_STATUS.get(status), f"status {status}", self._timeout_ms))

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
                raise LinkError(_in_words(error)) from error
            self._stalled = False


def _in_words(error: usb1.USBError) -> str:
    return in_words(_REFUSED.get(error.value), error)
