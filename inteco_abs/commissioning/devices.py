"""Boards that this computer has, as its kernel lists them: no board is opened, asked or written to."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from firmware_protocol.rtdac_usb2_bridge import VENDOR_ID
from inteco_abs.config import RigConfig
from inteco_abs.host.checks import Computer
from inteco_abs.host.permissions import PCI_DEVICE, PCI_VENDOR

_USB: Final = "sys/bus/usb/devices/*"
_PORTS: Final = "sys/bus/usb-serial/devices/*"
_PCI: Final = "sys/bus/pci/devices/*"
_TOLD: Final = ("manufacturer", "product", "serial", "speed")
_MOST_DESCRIPTOR_BYTES: Final = 4096
_PCI_HEADER_BYTES: Final = 64
"""Of the configuration space, what every user may read."""


class FoundBoard(NamedTuple):
    """A device that may be the board."""

    address: str
    """What to name after --board."""
    description: str
    """Ids, strings and place."""
    told: Mapping[str, str] = MappingProxyType({})
    """Strings and descriptors of the device, for a report."""


def found_devices(address: str, config: RigConfig, computer: Computer | None = None) -> list[FoundBoard]:
    """Devices of the kind that `address` names, in the order of their places; one alone if it names that one."""
    kind, _, rest = address.partition(":")
    found = _KINDS[kind](computer or Computer(), config)
    if kind != "usb" or not rest:
        return found
    named = Path(rest).resolve()
    if not named.is_char_device():
        return []
    chosen = [one for one in found if Path(one.address.removeprefix("usb:")) == named]
    return chosen or [FoundBoard(address, "a serial port that is behind no USB chip")]


def _usb2(computer: Computer, config: RigConfig) -> list[FoundBoard]:
    vendor, wanted = config.usb.vendor_id, config.usb.manufacturer.lower()
    found = []
    for folder in computer.matching(_USB):
        made_by = computer.text_or(f"{folder}/manufacturer", "").lower()
        id_there = computer.text_or(f"{folder}/idVendor", "")
        if (wanted in made_by and vendor in (None, int(id_there or "0", 16))) or (
            not made_by and id_there == f"{VENDOR_ID if vendor is None else vendor:04x}"
        ):
            serial = computer.text_or(f"{folder}/serial", "")
            address = f"usb2:{serial if serial.isdecimal() else ''}"
            found.append(FoundBoard(address, _usb_words(computer, folder), _usb_told(computer, folder)))
    return found


def _usb(computer: Computer, _: RigConfig) -> list[FoundBoard]:
    """Serial ports behind USB chips: the first RT-DAC/USB looks like any of them."""
    found = []
    for port in computer.matching(_PORTS):
        device = str((computer.root / port).resolve().parent.parent)  # port -> interface -> device
        words, told = _usb_words(computer, device), _usb_told(computer, device)
        found.append(FoundBoard(f"usb:/dev/{_name(port)}", words, told))
    return found


def _pci(computer: Computer, _: RigConfig) -> list[FoundBoard]:
    def is_board(folder: str) -> bool:
        ids = (computer.text_or(f"{folder}/vendor", ""), computer.text_or(f"{folder}/device", ""))
        return ids == (PCI_VENDOR, PCI_DEVICE)

    return [
        FoundBoard(
            f"pci:{_name(folder)}",
            f"{PCI_VENDOR}:{PCI_DEVICE} at {_name(folder)}",
            {"descriptors": computer.bytes_of(f"{folder}/config", _PCI_HEADER_BYTES).hex()},
        )
        for folder in computer.matching(_PCI)
        if is_board(folder)
    ]


def _usb_words(computer: Computer, folder: str) -> str:
    ids = ":".join(computer.text_or(f"{folder}/{name}", "????") for name in ("idVendor", "idProduct"))
    told = [f"{name} {text!r}" for name in _TOLD if (text := computer.text_or(f"{folder}/{name}", ""))]
    return " ".join([ids, *told, f"at USB port {_name(folder)}"])


def _usb_told(computer: Computer, folder: str) -> dict[str, str]:
    descriptors = computer.bytes_of(f"{folder}/descriptors", _MOST_DESCRIPTOR_BYTES).hex()
    told = {name: computer.text_or(f"{folder}/{name}", "") for name in _TOLD}
    return {name: text for name, text in {"descriptors": descriptors, **told}.items() if text}


def _name(folder: str) -> str:
    return folder.rpartition("/")[2]


_KINDS: Final[dict[str, Callable[[Computer, RigConfig], list[FoundBoard]]]] = {"usb2": _usb2, "usb": _usb, "pci": _pci}
