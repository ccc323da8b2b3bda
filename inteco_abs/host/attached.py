"""Lists the boards that are plugged in, their connection and this user's access, without opening one.

Each family brings its own checks: `BoardFamily.host`.
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
    """Argument of --board."""
    description: str
    """Ids, strings and place."""
    told: Mapping[str, str] = MappingProxyType({})  # a key of commissioning results
    """Strings and descriptors of the device, for a report."""


def _nothing(_: Computer) -> Judgement | None:
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class HostFamily:
    """How a computer lists the boards of one family; `BoardFamily.host` names it."""

    found: Callable[[Computer, RigConfig, str], list[FoundBoard]]
    """Lists devices that may be a board, in the order of their places; the text is the address after its colon, which
    may narrow the list to one."""
    folders: Callable[[Computer], list[str]]
    """Lists the kernel's folder for each board, relative to the root."""
    checks: Mapping[str, Callable[[Computer, str], Judgement]]
    """Checks of `doctor` for each of these folders."""
    place: str | None = None
    """Text before a folder's name when the board is listed; None: such a device may be something else."""
    missing_board_sign: Callable[[Computer], Judgement | None] = _nothing
    """If no board is found: looks for one that is not ready."""


def host_family(family: BoardFamily) -> HostFamily:
    """Return the host's part of a family."""
    found: HostFamily = attribute(family.host)
    return found


def found_devices(address: str, config: RigConfig, computer: Computer | None = None) -> list[FoundBoard]:
    """Return the devices of the family that `address` names, as the kernel lists them, without opening one."""
    name, _, rest = address.partition(":")
    return host_family(family_of(name)).found(computer or Computer(), config, rest)


def plugged_in(computer: Computer) -> list[CheckResult]:
    """Return the results for all boards; a single one if there are none."""
    known = [(family.title, host_family(family)) for family in known_families().values()]
    findings = look(computer, {"board": partial(_board, known)})
    for _, host in known:
        if folders := host.folders(computer):
            findings += look(computer, {name: partial(_all, check, folders) for name, check in host.checks.items()})
    return findings


def _all(check: Callable[[Computer, str], Judgement], folders: list[str], computer: Computer) -> Judgement:
    return together([check(computer, folder) for folder in folders])


def _board(known: list[tuple[str, HostFamily]], computer: Computer) -> Judgement:
    computer.text("proc/self/status")  # without these files an empty list means nothing
    certain = [(title, host, host.place) for title, host in known if host.place is not None]
    boards = [
        f"{title} at {place}{last_part(folder)}" for title, host, place in certain for folder in host.folders(computer)
    ]
    if boards:
        return green(", ".join(boards))
    signs = (sign for _, host in known if (sign := host.missing_board_sign(computer)) is not None)
    titles = " or ".join(title for title, *_ in certain)
    none = amber(f"no {titles} board plugged in", "plug the board in; if it is, try another cable or port")
    return next(signs, none)


def usb_description(computer: Computer, folder: str) -> str:
    """Describe a USB device by ids, strings and port."""
    ids = ":".join(computer.text_or(f"{folder}/{name}", "????") for name in ("idVendor", "idProduct"))
    strings = [f"{name} {text!r}" for name in _STRINGS if (text := computer.text_or(f"{folder}/{name}", ""))]
    return " ".join([ids, *strings, f"at USB port {last_part(folder)}"])


def usb_strings(computer: Computer, folder: str) -> dict[str, str]:
    """Return descriptors and strings of a USB device, for a report."""
    descriptors = computer.bytes_of(f"{folder}/descriptors", _MOST_DESCRIPTOR_BYTES).hex()
    strings = {name: computer.text_or(f"{folder}/{name}", "") for name in _STRINGS}
    return {name: text for name, text in {"descriptors": descriptors, **strings}.items() if text}


def last_part(folder: str) -> str:
    """Return the last part of a kernel's folder: a port, or an address on the bus."""
    return folder.rpartition("/")[2]
