"""Which boards are plugged in, how they are connected, and whether this user may use them. Asks no board anything."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from firmware_protocol.rtdac_usb2_bridge import MANUFACTURER
from inteco_abs.realtime.findings import Computer, Finding, Judgement, amber, green, look, red, together
from inteco_abs.realtime.permissions import PCI_DEVICE, PCI_REGISTERS, PCI_VENDOR, PLUG_AGAIN, UDEV_FILE

_HIGH_SPEED_MBIT_S: Final = 480.0
_LEAST_LATENCY_MS: Final = 1


def plugged_in(computer: Computer) -> list[Finding]:
    """Findings on the boards that are there; a single one when there are none."""
    findings = look(computer, {"board": _board})
    for folders_of, checks in _KINDS:
        folders = folders_of(computer)
        if folders:
            findings += look(computer, {name: partial(_all, check, folders) for name, check in checks.items()})
    return findings


def _all(check: Callable[[Computer, str], Judgement], folders: list[str], computer: Computer) -> Judgement:
    return together([check(computer, folder) for folder in folders])


def _board(computer: Computer) -> Judgement:
    computer.text("proc/self/status")  # without these, an empty list means nothing
    boards = [f"RT-DAC/USB2 at USB port {_name(folder)}" for folder in _usb_boards(computer)]
    boards += [f"RT-DAC4/PCI at {_name(folder)}" for folder in _pci_boards(computer)]
    if boards:
        return green(", ".join(boards))
    return amber(
        "no RT-DAC/USB2 or RT-DAC4/PCI board plugged in", "plug the board in; if it is, try another cable or port"
    )


def _usb_boards(computer: Computer) -> list[str]:
    """By the maker's name, as the vendor's software, the driver and the udev rules know the board, whatever its ids."""
    return [
        folder
        for folder in computer.matching("sys/bus/usb/devices/*")
        if MANUFACTURER.lower() in computer.text_or(f"{folder}/manufacturer", "").lower()
    ]


def _ftdi_ports(computer: Computer) -> list[str]:
    """Serial ports of FTDI chips: the first RT-DAC/USB looks like any of them."""
    ports = computer.matching("sys/bus/usb-serial/devices/ttyUSB*")
    return [port for port in ports if computer.text_or(f"{port}/latency_timer", "")]


def _pci_boards(computer: Computer) -> list[str]:
    def ids(folder: str) -> tuple[str, str]:
        return computer.text_or(f"{folder}/vendor", ""), computer.text_or(f"{folder}/device", "")

    return [folder for folder in computer.matching("sys/bus/pci/devices/*") if ids(folder) == (PCI_VENDOR, PCI_DEVICE)]


def _usb_speed(computer: Computer, folder: str) -> Judgement:
    speed = computer.text(f"{folder}/speed")
    if float(speed) >= _HIGH_SPEED_MBIT_S:
        return green(f"{speed} Mbit/s")
    return red(
        f"{speed} Mbit/s: one frame takes 1 ms, two periods",
        "plug the board straight into the computer, with a cable for USB 2.0, not into an old hub",
    )


def _usb_autosuspend(computer: Computer, folder: str) -> Judgement:
    file = f"{folder}/power/control"
    if computer.text(file) == "on":
        return green("off")
    return amber("on: an idle board is put to sleep", f"echo on | sudo tee /{file}, or install the udev rules")


def _usb_access(computer: Computer, folder: str) -> Judgement:
    bus, device = int(computer.text(f"{folder}/busnum")), int(computer.text(f"{folder}/devnum"))
    node = f"dev/bus/usb/{bus:03d}/{device:03d}"
    if not computer.exists(node):
        return red(f"no /{node}", "start udev; in a container, hand /dev/bus/usb on to it")
    if computer.may_write(node):
        return green(f"/{node} is writable")
    return red(f"/{node} is not writable for this user", PLUG_AGAIN)


def _ftdi_latency(computer: Computer, folder: str) -> Judgement:
    file = f"{folder}/latency_timer"
    latency_ms = int(computer.text(file))
    if latency_ms <= _LEAST_LATENCY_MS:
        return green(f"{_name(folder)} {latency_ms} ms")
    number = _serial_number(computer, folder)
    return amber(
        f"{_name(folder)} {latency_ms} ms, which each answer waits",
        f"if it is the board's: echo {_LEAST_LATENCY_MS} | sudo tee /{file}, or put its serial number{number} into "
        f"{UDEV_FILE}",
    )


def _serial_number(computer: Computer, folder: str) -> str:
    """Of a port's USB device, which is above it, in words; empty if it has none."""
    above = (computer.root / folder).resolve().parents
    number = next((text for place in above if (text := computer.text_or(str(place / "serial"), ""))), "")
    return f" {number}" if number else ""


def _pci_access(computer: Computer, folder: str) -> Judgement:
    file = f"{folder}/{PCI_REGISTERS}"
    if not computer.exists(file):
        return red(f"no /{file}", "the board has no register range: put it into another slot")
    if computer.may_write(file):
        return green(f"/{file} is writable")
    return red(f"/{file} is not writable for this user", PLUG_AGAIN)


def _pci_registers(computer: Computer, folder: str) -> Judgement:
    """The kernel counts who has switched a device on; firmware may have done so uncounted, which is not relied upon."""
    file = f"{folder}/enable"
    if computer.text(file) != "0":
        return green("switched on")
    return red("switched off", f"echo 1 | sudo tee /{file}, or install the udev rules ({UDEV_FILE})")


def _name(folder: str) -> str:
    return folder.rpartition("/")[2]


_KINDS: Final[
    tuple[tuple[Callable[[Computer], list[str]], Mapping[str, Callable[[Computer, str], Judgement]]], ...]
] = (
    (_usb_boards, {"USB speed": _usb_speed, "USB autosuspend": _usb_autosuspend, "USB access": _usb_access}),
    (_ftdi_ports, {"FTDI latency": _ftdi_latency}),
    (_pci_boards, {"PCI registers": _pci_registers, "PCI access": _pci_access}),
)
