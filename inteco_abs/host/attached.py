"""Which boards are plugged in, how they are connected, and whether this user may use them. Asks no board anything."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from firmware_protocol.rtdac_usb2_bridge import MANUFACTURER
from inteco_abs.host.checks import Computer, Finding, Judgement, amber, green, look, red, together
from inteco_abs.host.permissions import (
    INSTALL_FTDI_RULES,
    PCI_DEVICE,
    PCI_REGISTERS,
    PCI_VENDOR,
    PLUG_AGAIN,
    UDEV_FILE,
)
from inteco_abs.realtime.tuning import GUARDIAN_PRIORITY, LOOP_PRIORITY, cores_of, kernel_list, loop_cpus, parse_cpus

_UNPROGRAMMED: Final = "04b4", "8613"
"""What an EZ-USB FX2 calls itself as long as no firmware runs in it (its data sheet's default ids)."""
_INTERRUPT_PRIORITY: Final = (LOOP_PRIORITY + GUARDIAN_PRIORITY) // 2
"""On PREEMPT_RT the interrupt is a thread: above the loop, which waits for what it completes."""
_CPUS: Final = "sys/devices/system/cpu"
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
    for folder in computer.matching("sys/bus/usb/devices/*"):
        ids = computer.text_or(f"{folder}/idVendor", ""), computer.text_or(f"{folder}/idProduct", "")
        if ids == _UNPROGRAMMED:
            return red(
                f"a Cypress FX2 without firmware at USB port {_name(folder)}: a board that was not loaded?",
                "see `A board that is not loaded` in docs/boards.md",
            )
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


def _usb_interrupt(computer: Computer, folder: str) -> Judgement:
    """Where the host controller's interrupt is served, which completes every transfer of the board.

    Off the loop's CPU: there it would wait for a loop that waits for it. On PREEMPT_RT above the loop's priority.
    """
    online = parse_cpus(computer.text(f"{_CPUS}/online"))
    isolated = parse_cpus(computer.text_or(f"{_CPUS}/isolated", "")) & online
    loop = loop_cpus(online, isolated, cores_of(computer.root / _CPUS))
    parts = []
    for number in _interrupts(computer, folder):
        served = parse_cpus(computer.text(f"proc/irq/{number}/effective_affinity_list")) & online
        where = f"interrupt {number} on CPU {kernel_list(served)}"
        if served & loop:
            fix = f"echo {kernel_list(online - loop)} | sudo tee /proc/irq/{number}/smp_affinity_list"
            parts.append(amber(f"{where}, which is the loop's", fix))
        else:
            parts.append(_served_first(computer, number, where))
    return together(parts)


def _served_first(computer: Computer, number: int, where: str) -> Judgement:
    """The priority of an interrupt's thread, if it has one."""
    for file in computer.matching("proc/[0-9]*/comm"):
        if computer.text_or(file, "").startswith(f"irq/{number}-"):
            pid = file.split("/")[1]
            priority = int(computer.text(f"proc/{pid}/stat").rpartition(")")[2].split()[37])
            found = f"{where}, its thread with priority {priority}"
            if priority > LOOP_PRIORITY:
                return green(found)
            return amber(f"{found}, below the loop's {LOOP_PRIORITY}", f"sudo chrt -f -p {_INTERRUPT_PRIORITY} {pid}")
    return green(where)


def _interrupts(computer: Computer, folder: str) -> list[int]:
    """Numbers of the interrupts of the host controller that a USB device hangs on. Raises LookupError if not told."""
    for parent in (computer.root / folder).resolve().parents:
        if found := [int(file.name) for file in parent.glob("msi_irqs/[0-9]*")]:
            used = [number for number in found if computer.exists(f"proc/irq/{number}/effective_affinity_list")]
            return sorted(used or found)
        if (parent / "irq").is_file():
            return [int((parent / "irq").read_text(encoding="ascii"))]
    raise LookupError(folder)


def _ftdi_latency(computer: Computer, folder: str) -> Judgement:
    file = f"{folder}/latency_timer"
    latency_ms = int(computer.text(file))
    if latency_ms <= _LEAST_LATENCY_MS:
        return green(f"{_name(folder)} {latency_ms} ms")
    serial = computer.text_or(f"{folder}/../../serial", "")
    for_good = f"; for good: {INSTALL_FTDI_RULES.format(serial)}" if serial else ""
    return amber(
        f"{_name(folder)} {latency_ms} ms, which each answer waits",
        f"if it is the board, echo {_LEAST_LATENCY_MS} | sudo tee /{file}{for_good}",
    )


def _modem_manager(computer: Computer, folder: str) -> Judgement:
    if not any(computer.text_or(file, "") == "ModemManager" for file in computer.matching("proc/[0-9]*/comm")):
        return green("not running")
    serial = computer.text_or(f"{folder}/../../serial", "")
    if serial and f'"{serial}"' in computer.text_or(UDEV_FILE.lstrip("/"), ""):
        return green(f"leaves {_name(folder)} alone")
    return amber(
        f"it sends commands for modems to {_name(folder)} when that is plugged in",
        f"if it is the board: {INSTALL_FTDI_RULES.format(serial or 'NUMBER')}",
    )


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
    (
        _usb_boards,
        {
            "USB speed": _usb_speed,
            "USB autosuspend": _usb_autosuspend,
            "USB access": _usb_access,
            "USB interrupt": _usb_interrupt,
        },
    ),
    (_ftdi_ports, {"FTDI latency": _ftdi_latency, "ModemManager": _modem_manager}),
    (_pci_boards, {"PCI registers": _pci_registers, "PCI access": _pci_access}),
)
