"""Descriptors of a mock board on the bus (USB 2.0, chapter 9).

The real boards' descriptors are not published. The defaults are for the RT-DAC/USB2: the ids are guesses
(`rtdac_usb2_bridge`), the endpoints those of the vendor's program, class codes, release and current arbitrary.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum
from typing import Final

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from firmware_protocol.rtdac_usb2_bridge import ENDPOINT_JTAG_IN, ENDPOINT_JTAG_OUT, MANUFACTURER, PRODUCT_ID, VENDOR_ID

PRODUCT: Final = "RT-DAC/USB2 (mock, simulated rig)"
MOCK_SERIALS: Final = range(900_000_000, 1_000_000_000)
"""Serial numbers of mock boards, nine digits from 9 on, so that their data cannot be mistaken for measurements."""
RELEASE: Final = 0x0100
CONFIGURATION: Final = 1
"""Value of the only configuration."""
CONTROL_PACKET_BYTES: Final = 64
ENDPOINTS: Final = (ENDPOINT_OUT, ENDPOINT_IN, ENDPOINT_JTAG_OUT, ENDPOINT_JTAG_IN)
ENDPOINT_DIRECTION_IN: Final = 0x80

_DEVICE, _CONFIGURATION, _STRING, _INTERFACE, _ENDPOINT = 1, 2, 3, 4, 5
_VENDOR_SPECIFIC: Final = (0xFF, 0, 0)
"""Class, subclass and protocol."""
_BULK: Final = 2
_BUS_POWERED: Final = 0x80
_CURRENT_2MA: Final = 50
_LANGUAGE: Final = 0x0409
"""English (United States), the only language of the strings."""


class UsbSpeed(Enum):
    """Speed of the bus, by the size of a bulk packet in bytes (USB 2.0 section 5.8.3)."""

    FULL = 64
    HIGH = 512

    @property
    def packet_bytes(self) -> int:
        """Largest bulk packet."""
        return self.value


@dataclass(frozen=True, slots=True)
class UsbIdentity:
    """Ids, strings and endpoints of a mock board. Raises ValueError for those that no mock may have."""

    serial: int = MOCK_SERIALS.start + 1
    vendor_id: int = VENDOR_ID
    product_id: int = PRODUCT_ID
    speed: UsbSpeed = UsbSpeed.HIGH
    manufacturer: str = MANUFACTURER
    product: str = PRODUCT
    release: int = RELEASE
    """Binary-coded decimal; 0x0100 is 1.00."""
    device_class: tuple[int, int, int] = _VENDOR_SPECIFIC
    interface_class: tuple[int, int, int] = _VENDOR_SPECIFIC
    endpoints: tuple[int, ...] = ENDPOINTS
    """Addresses of the bulk endpoints."""

    def __post_init__(self) -> None:
        """Reject ids that do not fit their field and serial numbers that a real board may have."""
        for name, value in (("vendor id", self.vendor_id), ("product id", self.product_id)):
            if not 0 < value <= 0xFFFF:
                raise ValueError(f"{name} {value:#x}: must be in 0x0001..0xffff")
        if self.serial not in MOCK_SERIALS:
            raise ValueError(
                f"serial number {self.serial}: a mock board's must be in {MOCK_SERIALS[0]}..{MOCK_SERIALS[-1]}, "
                "so that its data cannot be mistaken for measurements"
            )

    @property
    def strings(self) -> tuple[str, str, str]:
        """Manufacturer, product and serial number: strings 1, 2 and 3."""
        return self.manufacturer, self.product, str(self.serial)

    def descriptor(self, kind: int, index: int) -> bytes | None:
        """Return the whole descriptor `index` of type `kind`; None if there is none."""
        if (kind, index) == (_DEVICE, 0):
            return self._device()
        if (kind, index) == (_CONFIGURATION, 0):
            return self._configuration()
        if kind == _STRING and index <= len(self.strings):
            return _string(index, self.strings)
        return None

    def _device(self) -> bytes:
        return struct.pack(
            "<BBHBBBBHHHBBBB",
            18,
            _DEVICE,
            0x0200,
            *self.device_class,
            CONTROL_PACKET_BYTES,
            self.vendor_id,
            self.product_id,
            self.release,
            1,
            2,
            3,
            1,
        )

    def _configuration(self) -> bytes:
        below = struct.pack("<BBBBBBBBB", 9, _INTERFACE, 0, 0, len(self.endpoints), *self.interface_class, 0)
        for address in self.endpoints:
            below += struct.pack("<BBBBHB", 7, _ENDPOINT, address, _BULK, self.speed.packet_bytes, 0)
        return (
            struct.pack("<BBHBBBBB", 9, _CONFIGURATION, 9 + len(below), 1, CONFIGURATION, 0, _BUS_POWERED, _CURRENT_2MA)
            + below
        )


def _string(index: int, strings: tuple[str, ...]) -> bytes:
    text = strings[index - 1].encode("utf-16-le") if index else _LANGUAGE.to_bytes(2, "little")
    return bytes((2 + len(text), _STRING)) + text
