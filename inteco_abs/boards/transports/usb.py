"""USB bulk transfers over pyusb: finds the RT-DAC/USB2, claims it, and carries its messages.

Endpoints 0x06 and 0x88 program the FPGA over JTAG and carry no data here. Opening a board resets all four pipes, as the
vendor's software does.
"""

from __future__ import annotations

import errno
import logging
import math
from array import array
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import usb.core
import usb.util

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT, FRAME_BYTES
from firmware_protocol.rtdac_usb2_bridge import ENDPOINT_JTAG_IN, ENDPOINT_JTAG_OUT, VENDOR_ID
from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.usb_errors import AT_ONCE_MS, RULES, TIMEOUT_MS, describe_usb_error, failure
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError

INTERFACE: Final = 0
"""The board's only interface."""
ENDPOINTS: Final = (ENDPOINT_OUT, ENDPOINT_IN, ENDPOINT_JTAG_OUT, ENDPOINT_JTAG_IN)
"""Endpoints of every RT-DAC/USB2; the vendor's software refuses a device without them."""
ONE_BY_ONE: Final = "one-by-one"
_HUB_CLASS: Final = 9
_DEVICES: Final = Path("/sys/bus/usb/devices")
_LOG: Final = logging.getLogger(__name__)


class UsbMatch(NamedTuple):
    """A device that may be the board."""

    device: Any
    manufacturer: str
    serial: str
    denied: bool
    """Whether it could not be read without permission."""

    def of(self, ids: UsbConfig) -> bool:
        """Return whether the board's maker has made it."""
        return ids.manufacturer.lower() in self.manufacturer.lower()

    def __str__(self) -> str:
        ids = f"{self.device.idVendor:04x}:{self.device.idProduct:04x}"
        return f"{ids} (no permission)" if self.denied else f"{ids} {self.manufacturer!r} serial {self.serial!r}"


class UsbLink(Link):
    """A link to the board with decimal serial number `serial`, or to the only board if it is empty.

    `backend` is pyusb's, for tests; `timeout_ms` is for each transfer. Detaches and logs a kernel driver that holds the
    board. Raises BoardError for no board or several, no permission, a board in use, or missing endpoints.
    """

    engine = ONE_BY_ONE

    def __init__(self, serial: str, ids: UsbConfig, backend: Any = None, timeout_ms: int = TIMEOUT_MS) -> None:
        self._device = find_usb_board(serial, ids, backend)
        try:
            usb.util.claim_interface(self._device, INTERFACE)
        except usb.core.USBError as error:
            usb.util.dispose_resources(self._device)
            raise BoardError(f"the board cannot be opened: {describe_usb_error(error.errno, error)}") from error
        self._write, self._read = self._device.write, self._device.read
        self._buffer = array("B", bytes(FRAME_BYTES))
        self.timeout_s = timeout_ms * 1e-3
        self._stalled = False

    @property  # libusb counts in whole milliseconds
    def timeout_s(self) -> float:
        """Time-out of each transfer, s."""
        return self._timeout_ms * 1e-3

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._timeout_ms = max(AT_ONCE_MS, math.ceil(round(timeout_s * 1e3, 6)))

    def prepare(self, length: int) -> None:
        """Reset all pipes, as the vendor's software does, and drop old answers."""
        with suppress(LinkError):  # a pipe that does not recover fails in the first reading
            self._reset(ENDPOINTS)
        super().prepare(length)

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        if self._stalled:  # an endpoint stays stalled until it is reset
            self._reset((ENDPOINT_OUT, ENDPOINT_IN))
            self._stalled = False
        try:
            sent = self._write(ENDPOINT_OUT, data, self._timeout_ms)
        except usb.core.USBError as error:
            raise self._failed(error) from error
        if sent != len(data):  # pyusb reports a time-out in the middle by the count
            raise LinkError(f"the board took {sent} of {len(data)} bytes in {self._timeout_ms} ms: check the cable")

    def read(self, length: int) -> bytes:
        """Receive one message."""
        return self._receive(length, self._timeout_ms)

    def close(self) -> None:
        """Release the interface."""
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
        return failure(error.errno, error, self._timeout_ms)

    def _reset(self, endpoints: tuple[int, ...]) -> None:
        try:
            for endpoint in endpoints:
                self._device.clear_halt(endpoint)
        except usb.core.USBError as error:
            raise LinkError(describe_usb_error(error.errno, error)) from error


def usb_boards(ids: UsbConfig, backend: Any = None) -> Iterator[UsbMatch]:
    """Yield devices that may be the board: by the maker's name, or by the configured id or the bridge's own.

    The vendor's software goes by the maker's name alone; case does not matter here. Raises BoardError without libusb.
    """
    try:
        found = list(usb.core.find(find_all=True, backend=backend))
    except usb.core.NoBackendError as error:
        raise BoardError("no libusb on this computer: install libusb-1.0-0") from error
    for device in found:
        if device.bDeviceClass == _HUB_CLASS or ids.product_id not in (None, device.idProduct):
            continue
        if ids.vendor_id not in (None, device.idVendor):
            continue
        seen = _seen(device, ids)
        if seen.of(ids) or device.idVendor == (ids.vendor_id or VENDOR_ID):
            yield seen


def _seen(device: Any, ids: UsbConfig) -> UsbMatch:
    """Read the device's strings; devices of another maker according to the kernel are not opened."""
    made_by = _kernel_string(device, "manufacturer")
    if made_by and ids.manufacturer.lower() not in made_by.lower():
        return UsbMatch(device, made_by, _kernel_string(device, "serial"), denied=False)
    try:
        return UsbMatch(device, str(device.manufacturer), str(device.serial_number), denied=False)
    except (ValueError, usb.core.USBError):  # pyusb: a device that cannot be opened "has no langid"
        return UsbMatch(device, made_by, "", denied=True)


def _kernel_string(device: Any, name: str) -> str:
    """Return a string that the kernel has read from the device; empty if not known."""
    place = f"{device.bus}-{'.'.join(map(str, device.port_numbers or ()))}"
    try:
        return (_DEVICES / place / name).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def find_usb_board(serial: str, ids: UsbConfig, backend: Any = None) -> Any:
    """Return pyusb's device of the board, or of the only one, without kernel drivers; raises BoardError."""
    seen = list(usb_boards(ids, backend))
    found = [one for one in seen if one.of(ids) and not one.denied and (not serial or _same_serial(one.serial, serial))]
    if len(found) == 1:
        device = found[0].device
        _require_endpoints(device)
        _detach_kernel_driver(device)
        return device
    named = f" with serial number {serial}" if serial else ""
    there = "Seen: " + ("; ".join(map(str, seen)) or "no similar device")
    if found:
        raise BoardError(f"{len(found)} boards{named}: name one, as in usb2:{found[0].serial}. {there}")
    if any(one.denied for one in seen):
        raise BoardError(f"no board{named} that may be opened. {there}. {RULES}")
    raise BoardError(f"no RT-DAC/USB2 board{named}: is it plugged in? Looked for a device {_wanted(ids)}. {there}")


def _wanted(ids: UsbConfig) -> str:
    """Describe the wanted device with the settings for it."""
    words = f"whose maker is {ids.manufacturer!r} (usb.manufacturer)"
    for name in ("vendor_id", "product_id"):
        number = getattr(ids, name)
        words += "" if number is None else f" with {name.replace('_', ' ')} {number:04x} (usb.{name})"
    return words


def _require_endpoints(device: Any) -> None:
    """Raise BoardError for a device without the board's four endpoints in its first setting."""
    there = {endpoint.bEndpointAddress for endpoint in device[0][INTERFACE, 0]}
    missing = [f"0x{address:02x}" for address in ENDPOINTS if address not in there]
    if missing:
        has = ", ".join(f"0x{address:02x}" for address in sorted(there)) or "none"
        raise BoardError(
            f"not an RT-DAC/USB2: endpoint {', '.join(missing)} is missing, the device has {has}. If it is one, its "
            "bridge runs other firmware than the vendor's: unplug it, plug it in again, try the vendor's software"
        )


def _same_serial(serial: str, wanted: str) -> bool:
    """Compare serial numbers as decimal integers, as the vendor's software does."""
    return serial.isdecimal() and int(serial) == int(wanted)


def _detach_kernel_driver(device: Any) -> None:
    """Detach a kernel driver that holds the board, such as usbtest, which takes any bridge with Cypress' ids.

    It stays detached until the board is plugged in again. Raises BoardError on failure.
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
            f"a kernel driver holds the board and cannot be detached ({describe_usb_error(error.errno, error)}): "
            "`lsusb -t` names it, `sudo modprobe -r NAME` removes it"
        ) from error
    _LOG.warning("a kernel driver held the board and was detached from it until it is plugged in again")
