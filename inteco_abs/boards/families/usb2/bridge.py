"""Vendor requests to the USB bridge of an RT-DAC/USB2: dates of its firmware, and an LED.

They use endpoint 0 only, need no claim, reach neither the FPGA nor an output, and are allowed while another program
drives the board. Source: docs/facts/boards.md#vendor-requests. `device` is pyusb's, from `usb_boards`.
"""

from __future__ import annotations

import errno
import struct
from typing import Any, Final, NamedTuple

import usb.core

from firmware_protocol.rtdac_usb2_bridge import (
    DATE_ADDRESSES_BYTES,
    DATE_BYTES,
    DATE_CHARACTERS,
    REQUEST_DATE,
    REQUEST_DATE_ADDRESSES,
    REQUEST_LED_OFF,
    REQUEST_LED_ON,
)
from inteco_abs.boards.transports.usb_errors import describe_usb_error
from inteco_abs.errors import LinkError

NOT_REPORTED: Final = "not reported"
_TIMEOUT_MS: Final = 1000
"""The vendor's own, for each endpoint (docs/facts/boards.md#endpoints); nothing is driven meanwhile."""
_FROM_DEVICE, _TO_DEVICE = 0xC0, 0x40
"""Vendor requests, recipient device: INFERRED, the defaults of the vendor's USB library."""
_ADDRESSES: Final = struct.Struct("<2xHH")


class FirmwareDates(NamedTuple):
    """Dates of the bridge's firmware as the board reports them, or NOT_REPORTED."""

    compiled: str
    released: str


def firmware_dates(device: Any) -> FirmwareDates:
    """Read the dates; NOT_REPORTED if the board refuses or answers nonsense. Raises LinkError for other failures."""
    answer = _ask(device, REQUEST_DATE_ADDRESSES, 0, DATE_ADDRESSES_BYTES)
    if len(answer) != _ADDRESSES.size:
        return FirmwareDates(NOT_REPORTED, NOT_REPORTED)
    compiled, released = _ADDRESSES.unpack(answer)
    return FirmwareDates(_date(device, compiled), _date(device, released))


def identify_led(device: Any, *, on: bool) -> bool:
    """Switch the middle LED to identify the board; return False if it refuses. Raises LinkError."""
    try:
        device.ctrl_transfer(_TO_DEVICE, REQUEST_LED_ON if on else REQUEST_LED_OFF, 0, 0, None, _TIMEOUT_MS)
    except usb.core.USBError as error:
        if error.errno == errno.EPIPE:
            return False
        raise LinkError(describe_usb_error(error.errno, error, _TIMEOUT_MS)) from error
    return True


def bridge_facts(device: Any) -> dict[str, str]:
    """Return facts of `device` from control requests that change nothing."""
    ids = f"{device.idVendor:04x}:{device.idProduct:04x}"
    try:
        compiled, released = firmware_dates(device)
    except LinkError as error:  # for information only
        compiled = released = f"not reported: {error}"
    return {
        "ids": ids,
        "serial": str(device.serial_number),
        "firmware_compiled": compiled,
        "firmware_released": released,
    }


def _date(device: Any, address: int) -> str:
    """Read a date: two-byte characters with the text in the lower bytes."""
    text = _ask(device, REQUEST_DATE, address, DATE_BYTES)[: 2 * DATE_CHARACTERS : 2].decode("latin-1").strip("\0 ")
    return text if text and text.isascii() and text.isprintable() else NOT_REPORTED


def _ask(device: Any, request: int, value: int, length: int) -> bytes:
    """Return the bridge's answer, empty if it refuses."""
    try:
        return bytes(device.ctrl_transfer(_FROM_DEVICE, request, value, 0, length, _TIMEOUT_MS))
    except usb.core.USBError as error:
        if error.errno == errno.EPIPE:
            return b""
        raise LinkError(describe_usb_error(error.errno, error, _TIMEOUT_MS)) from error
