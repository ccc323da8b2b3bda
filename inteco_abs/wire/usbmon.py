"""Decodes packets of USB bus monitors: usbmon (Linux) and USBPcap (Windows), a header before a transfer's data.

Sources: the kernel's documentation of usbmon, binary formats of 48 and of 64 bytes ("mmapped"); USBPcap's capture
format specification. usbmon uses the byte order of the capturing computer, as the file does; USBPcap is little-endian.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Final, NamedTuple

from inteco_abs.errors import CaptureError

IN: Final = 0x80
"""Bit of an endpoint address for the direction to the host."""
_SUBMITTED, _COMPLETED, _REFUSED = b"SCE"

_USBMON: Final = "QBBBBHbbqiiII8s"
_USBMON_BYTES: Final = 48
_MMAPPED_BYTES: Final = 64
_DESCRIPTOR_BYTES: Final = 16
"""Length of each isochronous descriptor between header and data."""
_NDESC_AT: Final = 60
_IN_PROGRESS: Final = -115
_SHORT: Final = -121
"""Short packet with valid data; the driver had requested an error for it."""
_USBPCAP: Final = struct.Struct("<HQIHBHHBBI")
_TO_HOST: Final = 1
_SETUP_STAGE: Final = 0
_SETUP_BYTES: Final = 8

LINUX_USB: Final = 189
LINUX_USB_MMAPPED: Final = 220
USBPCAP: Final = 249
LINK_TYPES: Final = {
    LINUX_USB: "usbmon with 48-byte headers",
    LINUX_USB_MMAPPED: "usbmon with 64-byte headers",
    USBPCAP: "USBPcap",
}
"""Supported link types."""


class Transfer(IntEnum):
    """Type of a transfer, as both monitors number it."""

    ISOCHRONOUS = 0
    INTERRUPT = 1
    CONTROL = 2
    BULK = 3


class MonitoredUrb(NamedTuple):
    """A transfer at its submission to the host controller, or at its end."""

    bus: int
    address: int
    endpoint: int
    """Address, with bit 7 for IN."""
    transfer: int
    """A `Transfer`, or a monitor's number for other events."""
    number: int
    """Identifies the two packets of a transfer; reused afterwards."""
    done: bool
    """Whether the transfer has ended, with or without an error."""
    failure: str
    """Reason of a failure; empty at submission and after success."""
    length: int
    """Length of the data in bytes, whether captured or not."""
    data: bytes
    setup: bytes = b""
    """Request of a control transfer, in the packet of its submission."""

    @property
    def device(self) -> str:
        """Bus and address as on the command line."""
        return f"{self.bus}.{self.address}"


def decode(packet: bytes, link_type: int, *, big_endian: bool = False) -> MonitoredUrb:
    """Decode a packet. Raises CaptureError for a truncated packet, or one that is not a USB monitor's."""
    if link_type == USBPCAP:
        return _usbpcap(packet)
    return _usbmon(
        packet, _MMAPPED_BYTES if link_type == LINUX_USB_MMAPPED else _USBMON_BYTES, ">" if big_endian else "<"
    )


def _usbmon(packet: bytes, header: int, order: str) -> MonitoredUrb:
    if len(packet) < header:
        raise CaptureError(f"has {len(packet)} bytes, a usbmon header has {header}")
    (number, kind, transfer, endpoint, address, bus, no_setup, no_data, _, _, status, length, captured, setup) = (
        struct.unpack_from(f"{order}{_USBMON}", packet)
    )
    if kind not in {_SUBMITTED, _COMPLETED, _REFUSED} or transfer > Transfer.BULK:
        raise CaptureError(
            f"is not a usbmon packet (type {kind:#04x}, transfer {transfer}): several interfaces in one file?"
        )
    data = b""
    if not no_data:
        start = header
        if transfer == Transfer.ISOCHRONOUS and header == _MMAPPED_BYTES:
            start += _DESCRIPTOR_BYTES * struct.unpack_from(f"{order}I", packet, _NDESC_AT)[0]
        elif len(packet) < header + captured:
            raise CaptureError(_cut(len(packet) - header, captured))
        data = packet[start : start + captured]
    done = kind != _SUBMITTED
    good = status in {0, _SHORT} or (status == _IN_PROGRESS and not done)
    failure = "" if good else f"status {status}"
    return MonitoredUrb(
        bus, address, endpoint, transfer, number, done, failure, length, data, b"" if no_setup else setup
    )


def _usbpcap(packet: bytes) -> MonitoredUrb:
    if len(packet) < _USBPCAP.size:
        raise CaptureError(f"has {len(packet)} bytes, a USBPcap header has at least {_USBPCAP.size}")
    header, number, status, _, info, bus, address, endpoint, transfer, length = _USBPCAP.unpack_from(packet)
    staged = transfer == Transfer.CONTROL
    if not _USBPCAP.size + staged <= header <= len(packet):
        raise CaptureError(f"is not a USBPcap packet: its header claims {header} bytes, the packet has {len(packet)}")
    data = packet[header : header + length]
    if len(data) < length:
        raise CaptureError(_cut(len(data), length))
    done = bool(info & _TO_HOST)
    setup = b""
    if staged and packet[_USBPCAP.size] == _SETUP_STAGE:
        setup, data = data[:_SETUP_BYTES], data[_SETUP_BYTES:]
    failure = f"USBD status 0x{status:08X}" if done and status else ""
    return MonitoredUrb(bus, address, endpoint, transfer, number, done, failure, len(data), data, setup)


def _cut(found: int, length: int) -> str:
    return f"is truncated: it has {found} of its {length} bytes of data. Capture again, without a length limit"
