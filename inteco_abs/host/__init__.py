"""The computer: what it grants a real-time process, which boards it has, and what to change."""

from inteco_abs.host.attached import (
    USB_DEVICES,
    FoundBoard,
    HostFamily,
    found_devices,
    last_part,
    usb_description,
    usb_strings,
)
from inteco_abs.host.checks import Computer, Finding, Judgement, Verdict, amber, as_facts, green, red, together, worst
from inteco_abs.host.permissions import (
    INSTALL_FTDI_RULES,
    PCI_DEVICE,
    PCI_REGISTERS,
    PCI_VENDOR,
    PLUG_AGAIN,
    UDEV_FILE,
    check_serial,
    limits,
    serial_group,
    udev_rules,
)

__all__ = [
    "INSTALL_FTDI_RULES",
    "PCI_DEVICE",
    "PCI_REGISTERS",
    "PCI_VENDOR",
    "PLUG_AGAIN",
    "UDEV_FILE",
    "USB_DEVICES",
    "Computer",
    "Finding",
    "FoundBoard",
    "HostFamily",
    "Judgement",
    "Verdict",
    "amber",
    "as_facts",
    "check_serial",
    "found_devices",
    "green",
    "last_part",
    "limits",
    "red",
    "serial_group",
    "together",
    "udev_rules",
    "usb_description",
    "usb_strings",
    "worst",
]
