"""USB bulk transfers over pyusb: finds the RT-DAC/USB2 board, claims it, carries its messages.

Endpoints 0x06 and 0x88 program the FPGA over JTAG; nothing here ever names them.
"""

from __future__ import annotations

import errno
import logging
from array import array
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final, NamedTuple

import usb.core
import usb.util

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT, FRAME_BYTES
from inteco_abs.boards.links import Link
from inteco_abs.boards.usb_words import AT_ONCE_MS, RULES, TIMEOUT_MS, in_words
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError

INTERFACE: Final = 0
"""The board's only one."""
_LOG: Final = logging.getLogger(__name__)


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

    `backend` is pyusb's, for tests; `timeout_ms` is for each transfer. A kernel driver that holds the board is
    detached, and the log says so. Raises BoardError if there is no such board, more than one, no permission, or if
    another program has it.
    """

    def __init__(self, serial: str, ids: UsbConfig, backend: Any = None, timeout_ms: int = TIMEOUT_MS) -> None:
        self._device = find_one(serial, ids, backend)
        try:
            usb.util.claim_interface(self._device, INTERFACE)
        except usb.core.USBError as error:
            usb.util.dispose_resources(self._device)
            raise BoardError(f"the board cannot be opened: {in_words(error.errno, error)}") from error
        self._write, self._read = self._device.write, self._device.read
        self._buffer = array("B", bytes(FRAME_BYTES))
        self._timeout_ms = timeout_ms
        self._stalled = False

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        if self._stalled:
            self._clear_halts()
        try:
            sent = self._write(ENDPOINT_OUT, data, self._timeout_ms)
        except usb.core.USBError as error:
            raise self._failed(error) from error
        if sent != len(data):  # pyusb tells a time-out in the middle by the count
            raise LinkError(f"the board took {sent} of {len(data)} bytes in {self._timeout_ms} ms: check the cable")

    def read(self, length: int) -> bytes:
        """Receive one message."""
        return self._receive(length, self._timeout_ms)

    def close(self) -> None:
        """Give the interface back."""
        with suppress(usb.core.USBError):  # it may be gone
            usb.util.dispose_resources(self._device)

    def _read_waiting(self, length: int) -> bytes:
        return self._receive(length, AT_ONCE_MS)

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
        return LinkError(in_words(error.errno, error, self._timeout_ms))

    def _clear_halts(self) -> None:
        """A stalled endpoint stays so until it is told otherwise."""
        try:
            for endpoint in (ENDPOINT_OUT, ENDPOINT_IN):
                self._device.clear_halt(endpoint)
        except usb.core.USBError as error:
            raise LinkError(in_words(error.errno, error)) from error
        self._stalled = False


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
    """Pyusb's device of the one board with that serial number, or of the only board, free of kernel drivers.

    Raises BoardError.
    """
    seen = list(boards(ids, backend))
    found = [one for one in seen if not one.denied and (not serial or _same(one.serial, serial))]
    if len(found) == 1:
        _free(found[0].device)
        return found[0].device
    named = f" with serial number {serial}" if serial else ""
    there = "; ".join(map(str, seen)) or f"none with vendor id {ids.vendor_id:04x}"
    if found:
        raise BoardError(f"{len(found)} boards{named}: name one, as in usb2:{found[0].serial}. Seen: {there}")
    if any(one.denied for one in seen):
        raise BoardError(f"no board{named} that may be opened; seen: {there}. {RULES}")
    raise BoardError(f"no RT-DAC/USB2 board{named}: is it plugged in? Seen: {there}")


def _same(serial: str, wanted: str) -> bool:
    """The vendor's software compares serial numbers as decimal integers."""
    return serial.isdecimal() and int(serial) == int(wanted)


def _free(device: Any) -> None:
    """Detach the kernel driver that holds the board; Linux' usbtest, for one, takes any bridge with Cypress' own ids.

    It stays detached until the board is plugged in again. Raises BoardError if it cannot be.
    """
    try:
        if not device.is_kernel_driver_active(INTERFACE):
            return
        device.detach_kernel_driver(INTERFACE)
    except NotImplementedError:
        return  # not on this system
    except usb.core.USBError as error:
        usb.util.dispose_resources(device)
        raise BoardError(
            f"a kernel driver holds the board and cannot be detached ({in_words(error.errno, error)}): "
            "`lsusb -t` names it, `sudo modprobe -r NAME` removes it"
        ) from error
    _LOG.warning("a kernel driver held the board and was detached from it until it is plugged in again")
