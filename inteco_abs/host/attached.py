"""Which boards are plugged in, how they are connected, and whether this user may use them. Asks no board anything.

What is to be looked at is each family's own: `BoardFamily.host`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Final, NamedTuple

from inteco_abs.boards import BoardFamily, family_of, known_families
from inteco_abs.config import RigConfig
from inteco_abs.entry_points import attribute
from inteco_abs.host.checks import CheckResult, Computer, Judgement, amber, green, look, together

USB_DEVICES: Final = "sys/bus/usb/devices/*"
_STRINGS: Final = ("manufacturer", "product", "serial", "speed")
_MOST_DESCRIPTOR_BYTES: Final = 4096


class FoundBoard(NamedTuple):
    """A device that may be the board."""

    address: str
    """What to name after --board."""
    description: str
    """Ids, strings and place."""
    told: Mapping[str, str] = MappingProxyType({})
    """Strings and descriptors of the device, for a report."""


def _nothing(_: Computer) -> Judgement | None:
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class HostFamily:
    """How a computer lists the boards of one family; `BoardFamily.host` names it."""

    found: Callable[[Computer, RigConfig, str], list[FoundBoard]]
    """Devices that may be a board, in the order of their places; one alone if the address, of which this is what stands
    after the colon, can only be that one."""
    folders: Callable[[Computer], list[str]]
    """Where the kernel tells about each of them, below its root."""
    checks: Mapping[str, Callable[[Computer, str], Judgement]]
    """What `doctor` looks at in each of these folders."""
    place: str | None = None
    """What stands before a folder's name when the board is listed; None: such a device may be anything else, too."""
    in_its_place: Callable[[Computer], Judgement | None] = _nothing
    """Where no board is found: a sign of one that is not ready, if there is any."""


def host_family(family: BoardFamily) -> HostFamily:
    """The host's side of a family."""
    found: HostFamily = attribute(family.host)
    return found


def found_devices(address: str, config: RigConfig, computer: Computer | None = None) -> list[FoundBoard]:
    """Devices of the family that `address` names, as the kernel lists them; no board is opened, asked or written to."""
    name, _, rest = address.partition(":")
    return host_family(family_of(name)).found(computer or Computer(), config, rest)


def plugged_in(computer: Computer) -> list[CheckResult]:
    """Findings on the boards that are there; a single one when there are none."""
    known = [(family.title, host_family(family)) for family in known_families().values()]
    findings = look(computer, {"board": partial(_board, known)})
    for _, host in known:
        if folders := host.folders(computer):
            findings += look(computer, {name: partial(_all, check, folders) for name, check in host.checks.items()})
    return findings


def _all(check: Callable[[Computer, str], Judgement], folders: list[str], computer: Computer) -> Judgement:
    return together([check(computer, folder) for folder in folders])


def _board(known: list[tuple[str, HostFamily]], computer: Computer) -> Judgement:
    computer.text("proc/self/status")  # without these, an empty list means nothing
    certain = [(title, host, host.place) for title, host in known if host.place is not None]
    boards = [
        f"{title} at {place}{last_part(folder)}" for title, host, place in certain for folder in host.folders(computer)
    ]
    if boards:
        return green(", ".join(boards))
    signs = (sign for _, host in known if (sign := host.in_its_place(computer)) is not None)
    titles = " or ".join(title for title, *_ in certain)
    none = amber(f"no {titles} board plugged in", "plug the board in; if it is, try another cable or port")
    return next(signs, none)


def usb_description(computer: Computer, folder: str) -> str:
    """Ids, strings and port of a USB device, for people."""
    ids = ":".join(computer.text_or(f"{folder}/{name}", "????") for name in ("idVendor", "idProduct"))
    told = [f"{name} {text!r}" for name in _STRINGS if (text := computer.text_or(f"{folder}/{name}", ""))]
    return " ".join([ids, *told, f"at USB port {last_part(folder)}"])


def usb_strings(computer: Computer, folder: str) -> dict[str, str]:
    """Descriptors and strings of a USB device, for a report."""
    descriptors = computer.bytes_of(f"{folder}/descriptors", _MOST_DESCRIPTOR_BYTES).hex()
    told = {name: computer.text_or(f"{folder}/{name}", "") for name in _STRINGS}
    return {name: text for name, text in {"descriptors": descriptors, **told}.items() if text}


def last_part(folder: str) -> str:
    """Name of a kernel's folder: a port, or an address on the bus."""
    return folder.rpartition("/")[2]
