"""What a lab computer needs that a user has not by default: two files and a group. `doctor` checks, `setup` makes it.

Both files use the group that owns serial ports (`dialout`, on some systems `uucp`), so that they also hold for remote
logins; at the computer itself the tag `uaccess` is enough for the USB board.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from inteco_abs.errors import ConfigError
from inteco_abs.host.checks import Check, Computer, Judgement, amber, green, red
from inteco_abs.realtime import GUARDIAN_PRIORITY

UDEV_FILE: Final = "/etc/udev/rules.d/70-inteco-abs.rules"
"""Sorts before 73, where the tag uaccess is read."""
LIMITS_FILE: Final = "/etc/security/limits.d/70-inteco-abs.conf"
PCI_VENDOR, PCI_DEVICE = "0x10b5", "0x2497"
PCI_REGISTERS: Final = "resource2"
"""The BAR with the registers (docs/facts/boards.md#identities)."""

_SERIAL_GROUPS: Final = ("dialout", "uucp")
_SERIAL: Final = re.compile(r"[\w-]{1,32}", re.ASCII)
_CAP_IPC_LOCK, _CAP_SYS_NICE = 14, 23
SET_UP: Final = 'sudo "$(command -v inteco-abs)" setup --apply'
"""Command that makes what is missing; sudo has another search path."""
INSTALL_FTDI_RULES: Final = f"{SET_UP} --ftdi-serial {{}}, then plug the board in again"
"""Format with the chip's serial number."""
_INSTALL_LIMITS: Final = f"{SET_UP}, then log in again"
ALLOW_AWAKE: Final = f"install the udev rules ({UDEV_FILE}), which allow writing /dev/cpu_dma_latency"
_PLUG_AGAIN: Final = f"install the udev rules ({UDEV_FILE}), then plug the board in again or restart the computer"


class SystemFile(NamedTuple):
    """A file of the system that this program needs."""

    name: str
    path: str
    text: str
    grants: str
    """What it is for."""


def needed_files(computer: Computer, ftdi_serial: str = "") -> tuple[SystemFile, ...]:
    """The files of the system that a lab computer needs; without `ftdi_serial`, that of the installed rules is kept."""
    group = serial_group(computer)
    serial = ftdi_serial or installed_serial(computer)
    return (
        SystemFile("udev rules", UDEV_FILE, udev_rules(group, serial), f"opens the boards to group {group}, and fast"),
        SystemFile("limits", LIMITS_FILE, limits(group), f"real-time priority and locked memory for group {group}"),
    )


def installed_serial(computer: Computer) -> str:
    """Serial number of the FTDI chip in the installed rules; empty without one."""
    serial = re.search(r'ATTRS\{serial\}=="([^"]*)"', computer.text_or(UDEV_FILE.lstrip("/"), ""))
    return serial[1] if serial else ""


def group_members(computer: Computer, group: str) -> set[str]:
    """Users that /etc/group lists in `group`."""
    lines = (line.split(":") for line in computer.text_or("etc/group", "").splitlines() if line.count(":") >= 3)
    return {user for name, _, _, users, *_ in lines if name == group for user in users.split(",") if user}


def serial_group(computer: Computer) -> str:
    """Return the group that owns serial ports here."""
    known = _group_ids(computer)
    return next((name for name in _SERIAL_GROUPS if name in known), _SERIAL_GROUPS[0])


def check_serial(serial: str) -> str:
    """Return `serial` if it can be an FTDI chip's serial number; else raise ConfigError."""
    if not _SERIAL.fullmatch(serial):
        problem = f"{serial!r}: must be 1 to 32 letters, digits, - and _, as inteco-abs doctor prints it"
        raise ConfigError.of("--ftdi-serial", problem)
    return serial


def writable(computer: Computer, file: str, missing: str = "", denied: str = _PLUG_AGAIN) -> Judgement:
    """Check that this user may write a board's file. `missing` and `denied` say what to do if not."""
    if missing and not computer.exists(file):
        return red(f"no /{file}", missing)
    if computer.may_write(file):
        return green(f"/{file} is writable")
    return red(f"/{file} is not writable for this user", denied)


def udev_rules(group: str, ftdi_serial: str = "") -> str:
    """Return the udev rules to install as `UDEV_FILE`.

    The ids of the first RT-DAC/USB are not known, and many instruments have the same FTDI chip: a chip that names
    neither Inteco nor RT-DAC is configured only if `ftdi_serial` is its serial number.
    """
    ours = ['ATTR{manufacturer}=="*[Ii][Nn][Tt][Ee][Cc][Oo]*"', 'ATTR{product}=="*[Rr][Tt]*[Dd][Aa][Cc]*"']
    if ftdi_serial:
        ours.append(f'ATTR{{serial}}=="{ftdi_serial}"')
    chips = [f'ATTR{{idVendor}}=="0403", {which}' for which in ours]
    ignored = "\n".join(f'{chip}, ENV{{ID_MM_DEVICE_IGNORE}}="1"' for chip in chips)
    quick = "\n".join(
        f'SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", {chip.replace("ATTR", "ATTRS")}, '
        'ATTR{latency_timer}="1", ATTR{event_char}="0x13F"'
        for chip in chips
    )
    return f"""\
# {UDEV_FILE}
# Opens the boards of the Inteco rigs to group {group} and to the user at the computer, and keeps them fast.
# `inteco-abs doctor --rules` prints this file, `inteco-abs setup` installs it and takes it away.

ACTION=="remove", GOTO="inteco_abs_end"

# RT-DAC/USB2: never put to sleep
SUBSYSTEM!="usb", GOTO="inteco_abs_not_usb"
ENV{{DEVTYPE}}!="usb_device", GOTO="inteco_abs_end"
ATTR{{manufacturer}}=="*[Ii][Nn][Tt][Ee][Cc][Oo]*", ENV{{INTECO_ABS}}="1"
ENV{{INTECO_ABS}}=="1", GROUP="{group}", MODE="0660", TAG+="uaccess", ATTR{{power/control}}="on"
# RT-DAC/USB of the first generation: ModemManager sends no commands for modems to it
{ignored}
GOTO="inteco_abs_end"
LABEL="inteco_abs_not_usb"

# the same board: an answer waits in the FTDI chip for 1 ms, not for 16 ms, and not at all once it has a byte 0x3F
{quick}

# RT-DAC4/PCI: its 64 registers, switched on, as no driver of the kernel does it
SUBSYSTEM=="pci", ATTR{{vendor}}=="{PCI_VENDOR}", ATTR{{device}}=="{PCI_DEVICE}", \
ATTR{{enable}}="1", RUN+="/bin/chgrp {group} /sys%p/{PCI_REGISTERS}", RUN+="/bin/chmod 0660 /sys%p/{PCI_REGISTERS}"

# the loop forbids deep sleep of the CPUs for as long as it runs
SUBSYSTEM=="misc", KERNEL=="cpu_dma_latency", GROUP="{group}", MODE="0660"

LABEL="inteco_abs_end"
"""


def limits(group: str) -> str:
    """Return the limits to install as `LIMITS_FILE`."""
    return f"""\
# {LIMITS_FILE}
# Lets group {group} run the 2 kHz loop before all other programs, and keep it in memory.
# `inteco-abs doctor --limits` prints this file, `inteco-abs setup` installs it and takes it away.
@{group} - rtprio 90
@{group} - memlock unlimited
"""


def _group_ids(computer: Computer) -> dict[str, str]:
    lines = computer.text_or("etc/group", "").splitlines()
    fields = [line.split(":") for line in lines if line.count(":") >= 2]
    return {name: number for name, _, number, *_ in fields}


def _status(computer: Computer) -> dict[str, str]:
    """Return the kernel's status of this process."""
    lines = computer.text("proc/self/status").splitlines()
    return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}


def _capable(computer: Computer, capability: int) -> bool:
    return bool(int(_status(computer)["CapEff"], 16) >> capability & 1)


def _soft_limit(computer: Computer, name: str) -> str:
    lines = [line for line in computer.text("proc/self/limits").splitlines() if line.startswith(name)]
    return lines[0].removeprefix(name).split()[0]


def _priority_limit(computer: Computer) -> Judgement:
    if _capable(computer, _CAP_SYS_NICE):
        return green("any priority (CAP_SYS_NICE)")
    allowed = _soft_limit(computer, "Max realtime priority")
    if allowed == "unlimited" or int(allowed) >= GUARDIAN_PRIORITY:
        return green(f"rtprio {allowed}")
    return red(
        f"rtprio {allowed}: any busy program delays the loop, whose guardian needs priority {GUARDIAN_PRIORITY}",
        _INSTALL_LIMITS,
    )


def _memory_limit(computer: Computer) -> Judgement:
    if _capable(computer, _CAP_IPC_LOCK):
        return green("may lock all memory (CAP_IPC_LOCK)")
    allowed = _soft_limit(computer, "Max locked memory")
    if allowed == "unlimited":
        return green("memlock unlimited")
    return amber(f"memlock {int(allowed) // 1024} KiB: a page fault may cost a tick", _INSTALL_LIMITS)


def _group(computer: Computer) -> Judgement:
    status = _status(computer)
    if status["Uid"].split()[0] == "0":
        return green("root needs no group")
    name = serial_group(computer)
    own = {*status["Groups"].split(), status["Gid"].split()[0]}
    if _group_ids(computer)[name] in own:
        return green(f"in group {name}")
    return amber(f"not in group {name}, which owns serial ports", f"{SET_UP}, then log in again")


def _udev_rules(computer: Computer) -> Judgement:
    if not computer.exists("sys"):
        raise FileNotFoundError(computer.root / "sys")
    installed = computer.text_or(UDEV_FILE.lstrip("/"), "")
    if installed == needed_files(computer)[0].text.strip():
        return green("installed")
    return amber("installed, but not those of this version" if installed else "not installed", SET_UP)


CHECKS: Final[dict[str, Check]] = {
    "priority limit": _priority_limit,
    "memory limit": _memory_limit,
    "group": _group,
    "udev rules": _udev_rules,
}
