"""USB bulk transfers over pyusb: finds the RT-DAC/USB2 board, claims it, carries its messages.

Endpoints 0x06 and 0x88 program the FPGA over JTAG; nothing here ever names them.
"""

from __future__ import annotations

import errno
from array import array
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final, NamedTuple

import usb.core
import usb.util

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT, FRAME_BYTES
from inteco_abs.boards.links import Link
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError

TIMEOUT_MS: Final = 10
"""Far below the window after which a silent loop counts as hung; libusb knows whole milliseconds only."""
_AT_ONCE_MS: Final = 1
_MOST_WAITING: Final = 4
_RULES: Final = "inteco-abs doctor --rules prints the udev rule that gives you access; then plug the board in again"

_WORDS: Final = {
    errno.ENODEV: "the board is gone: check cable and power",
    errno.EIO: "the bus failed: check the cable, avoid hubs",
    errno.EPIPE: "the board refused the transfer (stall)",
    errno.ETIMEDOUT: f"the board did not answer within {TIMEOUT_MS} ms",
    errno.EACCES: f"no permission: {_RULES}",
    errno.EBUSY: "another program or a kernel driver has the board: one program at a time",
    errno.EOVERFLOW: "the board sent more than was asked for",
}
"""What the errors of libusb mean here (fact sheet on emulated hardware, section 4)."""


class Seen(NamedTuple):
    """A device that may be the board."""

    device: Any
    manufacturer: str
    serial: str
    denied: bool
    """It could not be read, for want of permission."""

    def __str__(self) -> str:
        ids = f"{self.device.idVendor:04x}:{self.device.idProduct:04x}"
        return f"{ids} (no permission)" if self.denied else f"{ids} {self.manufacturer!r} serial {self.serial!r}"


class UsbLink(Link):
    """The board with decimal serial number `serial`, or the only one there is if it is empty.

    `backend` is pyusb's, for tests. Raises BoardError if there is no such board, more than one, no permission, or if
    another program has it.
    """

    def __init__(self, serial: str, ids: UsbConfig, backend: Any = None) -> None:
        self._device = find_one(serial, ids, backend)
        try:
            self._interface = self._device.get_active_configuration()[(0, 0)].bInterfaceNumber
            usb.util.claim_interface(self._device, self._interface)
        except usb.core.USBError as error:
            usb.util.dispose_resources(self._device)
            raise BoardError(f"the board cannot be opened: {in_words(error)}") from error
        self._write, self._read = self._device.write, self._device.read
        self._buffer = array("B", bytes(FRAME_BYTES))
        self._stalled = False

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        if self._stalled:
            self._clear_halts()
        try:
            sent = self._write(ENDPOINT_OUT, data, TIMEOUT_MS)
        except usb.core.USBError as error:
            raise self._failed(error) from error
        if sent != len(data):
            raise LinkError(f"the board took {sent} of {len(data)} bytes")

    def read(self, length: int) -> bytes:
        """Receive one message."""
        return self._receive(length, TIMEOUT_MS)

    def discard(self, length: int) -> None:
        """Drop what has arrived by now; waits for a millisecond, libusb's least."""
        with suppress(LinkError):
            for _ in range(_MOST_WAITING):
                self._receive(length, _AT_ONCE_MS)

    def close(self) -> None:
        """Give the interface back."""
        with suppress(usb.core.USBError):  # it may be gone
            usb.util.dispose_resources(self._device)

    def _receive(self, length: int, timeout_ms: int) -> bytes:
        if len(self._buffer) != length:
            self._buffer = array("B", bytes(length))
        try:
            count = self._read(ENDPOINT_IN, self._buffer, timeout_ms)
        except usb.core.USBError as error:
            raise self._failed(error) from error
        return self._buffer.tobytes() if count == length else self._buffer[:count].tobytes()

    def _failed(self, error: usb.core.USBError) -> LinkError:
        self._stalled = self._stalled or error.errno == errno.EPIPE
        return LinkError(in_words(error))

    def _clear_halts(self) -> None:
        """A stalled endpoint stays so until it is told otherwise."""
        try:
            for endpoint in (ENDPOINT_OUT, ENDPOINT_IN):
                self._device.clear_halt(endpoint)
        except usb.core.USBError as error:
            raise LinkError(in_words(error)) from error
        self._stalled = False


def in_words(error: usb.core.USBError) -> str:
    """What a failed transfer or request means to the person at the rig."""
    return _WORDS.get(error.errno, str(error))


def boards(ids: UsbConfig, backend: Any = None) -> Iterator[Seen]:
    """Devices with the configured ids whose manufacturer is the board's, or which may not be read.

    Raises BoardError where this computer has no libusb.
    """
    wanted = {"idVendor": ids.vendor_id}
    if ids.product_id is not None:
        wanted["idProduct"] = ids.product_id
    try:
        found = list(usb.core.find(find_all=True, backend=backend, **wanted))
    except usb.core.NoBackendError as error:
        raise BoardError("no libusb on this computer: install libusb-1.0-0") from error
    for device in found:
        try:
            seen = Seen(device, str(device.manufacturer), str(device.serial_number), denied=False)
        except (ValueError, usb.core.USBError):  # pyusb: a device that cannot be opened "has no langid"
            seen = Seen(device, "", "", denied=True)
        if seen.denied or seen.manufacturer == ids.manufacturer:
            yield seen


def find_one(serial: str, ids: UsbConfig, backend: Any = None) -> Any:
    """Pyusb's device of the one board with that serial number, or of the only board; raises BoardError."""
    seen = list(boards(ids, backend))
    found = [one for one in seen if not one.denied and (not serial or _same(one.serial, serial))]
    if len(found) == 1:
        return found[0].device
    named = f" with serial number {serial}" if serial else ""
    there = "; ".join(map(str, seen)) or f"none with vendor id {ids.vendor_id:04x}"
    if found:
        raise BoardError(f"{len(found)} boards{named}: name one, as in usb2:{found[0].serial}. Seen: {there}")
    if any(one.denied for one in seen):
        raise BoardError(f"no board{named} that may be opened; seen: {there}. {_RULES}")
    raise BoardError(f"no RT-DAC/USB2 board{named}: is it plugged in? Seen: {there}")


def _same(serial: str, wanted: str) -> bool:
    """The vendor's software compares serial numbers as decimal integers."""
    return serial.isdecimal() and int(serial) == int(wanted)
