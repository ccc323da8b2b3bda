"""Lists RT-DAC/USB2 boards, and checks access, speed and interrupts, without opening one."""

from __future__ import annotations

from typing import Final

from firmware_protocol.rtdac_usb2_bridge import MANUFACTURER, VENDOR_ID
from inteco_abs.config import RigConfig
from inteco_abs.host import (
    USB_DEVICES,
    Computer,
    FoundBoard,
    HostFamily,
    Judgement,
    amber,
    green,
    last_part,
    red,
    together,
    usb_description,
    usb_strings,
    writable,
)
from inteco_abs.realtime import GUARDIAN_PRIORITY, LOOP_PRIORITY, cores_of, kernel_list, loop_cpus, parse_cpus

_UNPROGRAMMED: Final = "04b4", "8613"
"""Ids of an EZ-USB FX2 without firmware (its data sheet's defaults)."""
_INTERRUPT_PRIORITY: Final = (LOOP_PRIORITY + GUARDIAN_PRIORITY) // 2
"""On PREEMPT_RT the interrupt is a thread: above the loop, which waits for what it completes."""
_CPUS: Final = "sys/devices/system/cpu"
_HIGH_SPEED_MBIT_S: Final = 480.0


def _found(computer: Computer, config: RigConfig, _serial: str) -> list[FoundBoard]:
    vendor, wanted = config.usb.vendor_id, config.usb.manufacturer.lower()
    found = []
    for folder in computer.matching(USB_DEVICES):
        made_by = computer.text_or(f"{folder}/manufacturer", "").lower()
        id_there = computer.text_or(f"{folder}/idVendor", "")
        if (wanted in made_by and vendor in (None, int(id_there or "0", 16))) or (
            not made_by and id_there == f"{VENDOR_ID if vendor is None else vendor:04x}"
        ):
            serial = computer.text_or(f"{folder}/serial", "")
            address = f"usb2:{serial if serial.isdecimal() else ''}"
            found.append(FoundBoard(address, usb_description(computer, folder), usb_strings(computer, folder)))
    return found


def _usb_boards(computer: Computer) -> list[str]:
    """List boards by the maker's name, as the vendor's software, the driver and the udev rules do."""
    return [
        folder
        for folder in computer.matching(USB_DEVICES)
        if MANUFACTURER.lower() in computer.text_or(f"{folder}/manufacturer", "").lower()
    ]


def _unprogrammed(computer: Computer) -> Judgement | None:
    for folder in computer.matching(USB_DEVICES):
        ids = computer.text_or(f"{folder}/idVendor", ""), computer.text_or(f"{folder}/idProduct", "")
        if ids == _UNPROGRAMMED:
            return red(
                f"a Cypress FX2 without firmware at USB port {last_part(folder)}: a board that was not loaded?",
                "see `A board that is not loaded` in docs/boards.md",
            )
    return None


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
    missing = "start udev; in a container, hand /dev/bus/usb on to it"
    return writable(computer, f"dev/bus/usb/{bus:03d}/{device:03d}", missing)


def _usb_interrupt(computer: Computer, folder: str) -> Judgement:
    """Check where the host controller's interrupt is served, which completes the board's transfers.

    It must be off the loop's CPU, where it would wait for the loop; on PREEMPT_RT above the loop's priority.
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
    """Judge the priority of an interrupt's thread, if it has one."""
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
    """Return the interrupt numbers of a USB device's host controller. Raises LookupError if not known."""
    for parent in (computer.root / folder).resolve().parents:
        if found := [int(file.name) for file in parent.glob("msi_irqs/[0-9]*")]:
            used = [number for number in found if computer.exists(f"proc/irq/{number}/effective_affinity_list")]
            return sorted(used or found)
        if (parent / "irq").is_file():
            return [int((parent / "irq").read_text(encoding="ascii"))]
    raise LookupError(folder)


HOST: Final = HostFamily(
    found=_found,
    folders=_usb_boards,
    place="USB port ",
    missing_board_sign=_unprogrammed,
    checks={
        "USB speed": _usb_speed,
        "USB autosuspend": _usb_autosuspend,
        "USB access": _usb_access,
        "USB interrupt": _usb_interrupt,
    },
)
