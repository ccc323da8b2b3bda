"""Lists RT-DAC4/PCI boards, and checks this user's access to their registers, without opening one."""

from __future__ import annotations

from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.host import (
    PCI_DEVICE,
    PCI_REGISTERS,
    PCI_VENDOR,
    UDEV_FILE,
    Computer,
    FoundBoard,
    HostFamily,
    Judgement,
    green,
    last_part,
    red,
    writable,
)

_HEADER_BYTES: Final = 64
"""Bytes of the configuration space that every user may read."""


def _boards(computer: Computer) -> list[str]:
    def ids(folder: str) -> tuple[str, str]:
        return computer.text_or(f"{folder}/vendor", ""), computer.text_or(f"{folder}/device", "")

    return [folder for folder in computer.matching("sys/bus/pci/devices/*") if ids(folder) == (PCI_VENDOR, PCI_DEVICE)]


def _found(computer: Computer, _: RigConfig, _place: str) -> list[FoundBoard]:
    return [
        FoundBoard(
            f"pci:{last_part(folder)}",
            f"{PCI_VENDOR}:{PCI_DEVICE} at {last_part(folder)}",
            {"descriptors": computer.bytes_of(f"{folder}/config", _HEADER_BYTES).hex()},
        )
        for folder in _boards(computer)
    ]


def _pci_access(computer: Computer, folder: str) -> Judgement:
    missing = "the board has no register range: put it into another slot"
    return writable(computer, f"{folder}/{PCI_REGISTERS}", missing)


def _pci_registers(computer: Computer, folder: str) -> Judgement:
    """Check the kernel's count of enables; the firmware may have enabled the device uncounted."""
    file = f"{folder}/enable"
    if computer.text(file) != "0":
        return green("switched on")
    return red("switched off", f"echo 1 | sudo tee /{file}, or install the udev rules ({UDEV_FILE})")


HOST: Final = HostFamily(
    found=_found, folders=_boards, place="", checks={"PCI registers": _pci_registers, "PCI access": _pci_access}
)
