"""The board families that ship: a folder each, whose `FAMILY` has all that other code asks for (boards/family.py)."""

from typing import Final

SHIPPED: Final = {
    "usb2": "inteco_abs.boards.families.usb2:FAMILY",
    "usb": "inteco_abs.boards.families.usb:FAMILY",
    "pci": "inteco_abs.boards.families.pci:FAMILY",
    "open": "inteco_abs.boards.families.open:FAMILY",
}
"""Families by name; as text, so that a family is imported when it is used."""
