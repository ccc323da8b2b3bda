"""RT-DAC/USB2 on the bus: ids, strings, endpoints and vendor requests of its Cypress bridge.

`rtdac_usb2` has the frames for the two data endpoints. Sources: S1 and S4 of docs/facts/sources.md.
"""

from typing import Final

VENDOR_ID: Final = 0x04B4
"""UNKNOWN: the vendor's program does not compare it. Weak guess (INFERRED): the bridge's maker, Cypress."""
PRODUCT_ID: Final = 0x8613
"""UNKNOWN, as the vendor id. Weak guess (INFERRED): the default of this family of bridges."""
MANUFACTURER: Final = "InTeCo"
"""String by which the vendor's program finds its boards (S1); then it compares serial numbers as decimals."""

ENDPOINT_JTAG_OUT: Final = 0x06
ENDPOINT_JTAG_IN: Final = 0x88
"""The two endpoints that program the FPGA. Never use them."""

REQUEST_DATE_ADDRESSES: Final = 0xD9
"""IN, wValue 0, 6 bytes: address of the compile date in bytes 2-3, of the release date in 4-5, little-endian (S4)."""
REQUEST_DATE: Final = 0xDA
"""IN, wValue an address, 32 bytes: 2-byte characters, the first 10 of which are a date of the firmware (S4)."""
REQUEST_LED_OFF: Final = 0xDE
REQUEST_LED_ON: Final = 0xDF
"""OUT, wValue 0, no data: the middle LED (S4); harmless, shows which board it is."""
DATE_ADDRESSES_BYTES: Final = 6
DATE_BYTES: Final = 32
DATE_CHARACTERS: Final = 10
