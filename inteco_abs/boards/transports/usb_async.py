"""USB bulk transfers with all three of a tick in flight at once: libusb's asynchronous calls, over python-libusb1.

A tick waits for the bus once instead of three times; docs/real-time.md has the figures.
"""

from __future__ import annotations

import errno
import select
import time
from contextlib import suppress
from typing import Any, Final

import usb1

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.usb import ENDPOINTS, INTERFACE, ONE_BY_ONE, find_usb_board
from inteco_abs.boards.transports.usb_errors import TIMEOUT_MS, describe_usb_error, failure
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError

QUEUED: Final = "queued"
_AT_ONCE_S: Final = 0.00025
"""Two microframes of 125 us, within which the bus delivers what has arrived."""
_CANCEL_S: Final = 0.1
_STUCK: Final = f"the bus has not returned a cancelled transfer within {_CANCEL_S * 1e3:g} ms: plug the board in again"

_STATUS: Final = {
    usb1.TRANSFER_ERROR: errno.EIO,
    usb1.TRANSFER_TIMED_OUT: errno.ETIMEDOUT,
    usb1.TRANSFER_CANCELLED: errno.ETIMEDOUT,
    usb1.TRANSFER_STALL: errno.EPIPE,
    usb1.TRANSFER_NO_DEVICE: errno.ENODEV,
    usb1.TRANSFER_OVERFLOW: errno.EOVERFLOW,
}
"""Errno of a transfer's end, as pyusb gives it."""
_REFUSED: Final = {
    usb1.ERROR_IO: errno.EIO,
    usb1.ERROR_ACCESS: errno.EACCES,
    usb1.ERROR_NO_DEVICE: errno.ENODEV,
    usb1.ERROR_BUSY: errno.EBUSY,
    usb1.ERROR_TIMEOUT: errno.ETIMEDOUT,
    usb1.ERROR_PIPE: errno.EPIPE,
    usb1.ERROR_OVERFLOW: errno.EOVERFLOW,
}
"""Errno of a call that libusb refused, likewise."""


class QueuedUsbLink(Link):
    """A link to the board that queues transfers; opens it and raises BoardError as `usb.UsbLink` does.

    A call waits `timeout_s` for all its transfers together, exact to some 50 us; libusb's time-outs are whole ms.
    """

    engines: tuple[str, ...] = (QUEUED, ONE_BY_ONE)

    def __init__(self, serial: str, ids: UsbConfig, timeout_ms: int = TIMEOUT_MS) -> None:
        found = find_usb_board(serial, ids)
        self._context = usb1.USBContext()
        self._context.open()
        try:
            self._handle = self._open(found.bus, found.address)
            self._handle.claimInterface(INTERFACE)
        except usb1.USBError as error:
            self._context.close()
            raise BoardError(f"the board cannot be opened: {_describe(error)}") from error
        self._begin(self._context, self._handle, timeout_ms * 1e-3)

    def _begin(self, context: Any, handle: Any, timeout_s: float) -> None:
        self._context, self._handle = context, handle
        self._first, self._second, self._answer = (handle.getTransfer() for _ in range(3))
        watched = context.getPollFDList()
        self._readable = [fd for fd, events in watched if events & select.POLLIN]
        self._writable = [fd for fd, events in watched if events & select.POLLOUT]  # of usbfs: a transfer has ended
        self.timeout_s = timeout_s
        self.engine = QUEUED
        self._stalled = False
        self._stuck = False  # whether a cancelled transfer has not come back

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        self._recover()
        self._first.setBulk(ENDPOINT_OUT, bytes(data))
        self._finish(self.timeout_s, self._first)

    def read(self, length: int) -> bytes:
        """Receive one message."""
        return self._receive(length, self.timeout_s)

    def exchange(self, first: bytes | bytearray, second: bytes, length: int) -> bytes:
        """Send two messages and receive one; the queued engine submits all before the first is done."""
        if self.engine != QUEUED:
            return super().exchange(first, second, length)
        self._recover()
        self._first.setBulk(ENDPOINT_OUT, bytes(first))
        self._second.setBulk(ENDPOINT_OUT, second)
        self._answer.setBulk(ENDPOINT_IN, length)
        self._finish(self.timeout_s, self._first, self._second, self._answer)
        return bytes(self._answer.getBuffer()[: self._answer.getActualLength()])

    def prepare(self, length: int) -> None:
        """Reset all pipes, as the vendor's software does, and drop old answers."""
        with suppress(LinkError):  # a pipe that does not recover fails in the first reading
            self._reset(ENDPOINTS)
        super().prepare(length)

    def close(self) -> None:
        """Release the interface; may be called twice."""
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
        return self._receive(length, _AT_ONCE_S)

    def _receive(self, length: int, timeout_s: float) -> bytes:
        self._require_returned()
        self._answer.setBulk(ENDPOINT_IN, length)
        self._finish(timeout_s, self._answer)
        return bytes(self._answer.getBuffer()[: self._answer.getActualLength()])

    def _finish(self, timeout_s: float, *transfers: Any) -> None:
        """Submit the transfers in order and wait for all; raises LinkError for the first failure."""
        try:
            for transfer in transfers:
                transfer.submit()
            self._wait(time.monotonic() + timeout_s, transfers)
        except BaseException as error:
            self._cancel(transfers)  # also after Ctrl-C: writing SAFE needs them again
            if isinstance(error, usb1.USBError):
                raise LinkError(_describe(error)) from error
            raise
        ended = [transfer.getStatus() for transfer in transfers if not transfer.isSubmitted()]
        self._stalled = self._stalled or usb1.TRANSFER_STALL in ended
        if self._stuck:
            raise LinkError(_STUCK)
        for status in ended:
            if status != usb1.TRANSFER_COMPLETED:
                raise failure(_STATUS.get(status), f"status {status}", timeout_s * 1e3)

    def _wait(self, end_s: float, transfers: tuple[Any, ...]) -> None:
        """Wait until all have ended; cancel the rest at `end_s`."""
        while any(transfer.isSubmitted() for transfer in transfers):
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                self._cancel(transfers)
                return
            select.select(self._readable, self._writable, (), left_s)
            self._context.handleEventsTimeout(0)

    def _cancel(self, transfers: tuple[Any, ...]) -> None:
        """Cancel the transfers, and wait until the bus returns their memory."""
        for transfer in transfers:
            with suppress(usb1.USBError):
                transfer.cancel()
        end = time.monotonic() + _CANCEL_S
        while any(transfer.isSubmitted() for transfer in transfers) and time.monotonic() < end:
            with suppress(usb1.USBError):
                self._context.handleEventsTimeout(0.001)
        self._stuck = any(transfer.isSubmitted() for transfer in transfers)

    def _require_returned(self) -> None:
        """Raise LinkError while a cancelled transfer has not come back: its memory must not be used again."""
        if self._stuck:
            self._cancel((self._first, self._second, self._answer))
            if self._stuck:
                raise LinkError(_STUCK)

    def _recover(self) -> None:
        """Reset stalled endpoints, which stay stalled otherwise."""
        self._require_returned()
        if self._stalled:
            self._reset((ENDPOINT_OUT, ENDPOINT_IN))
            self._stalled = False

    def _reset(self, endpoints: tuple[int, ...]) -> None:
        try:
            for endpoint in endpoints:
                self._handle.clearHalt(endpoint)
        except usb1.USBError as error:
            raise LinkError(_describe(error)) from error


def _describe(error: usb1.USBError) -> str:
    return describe_usb_error(_REFUSED.get(error.value), error)
