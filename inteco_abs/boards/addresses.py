"""Board addresses, such as `sim:` or `usb2:123`: what they look like, and what stands behind each."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from inteco_abs.config import DEFAULT_PROFILE, MOCK_NAMES, RigConfig, beyond_ceilings
from inteco_abs.errors import ConfigError, ConfigIssue


class Scheme(NamedTuple):
    """What stands before an address's colon."""

    what: str
    rest: re.Pattern[str]
    """What may stand after the colon."""
    wanted: str
    """The same in words."""
    profile: str
    """Profile to begin with."""


SCHEMES: Final = {
    "sim": Scheme(
        "the mock of the profile's board with the simulated rig inside",
        re.compile(r""),
        "nothing may follow sim:",
        DEFAULT_PROFILE,
    ),
    "usb2": Scheme(
        "an RT-DAC/USB2, by its decimal serial number if there are several",
        re.compile(r"[0-9]*"),
        "after usb2: comes a decimal serial number, as in usb2:123",
        "usb2_generic_0103",
    ),
    "usb": Scheme(
        "an RT-DAC/USB of the first generation, by its serial port if there are several",
        re.compile(r"(/.+)?"),
        "after usb: comes the path of a serial port, as in usb:/dev/ttyUSB0",
        "usb1_0111",
    ),
    "pci": Scheme(
        "an RT-DAC4/PCI, by its PCI address if there are several",
        re.compile(r"([0-9a-f]{4}:)?([0-9a-f]{2}:[0-9a-f]{2}\.[0-7])?", re.IGNORECASE),
        "after pci: comes the address as lspci -D shows it, as in pci:0000:03:0a.0",
        "pci_abs_50f",
    ),
}
"""Addresses that this version opens, by what stands before the colon."""


def check_address(uri: str) -> None:
    """Raise ConfigError unless `uri` is a board address."""
    name, colon, rest = uri.partition(":")
    scheme = SCHEMES.get(name) if colon else None
    if scheme is None:
        known = "; ".join(f"{one}: is {scheme.what}" for one, scheme in SCHEMES.items())
        meant = f"usb:{uri}" if uri.startswith("/dev/") else f"{uri}:" if uri in SCHEMES else ""
        hint = f"; did you mean {meant}?" if meant else ""
        raise ConfigError(
            [ConfigIssue("--board", f"{uri!r} is not a board address of this version{hint or ';'} {known}")]
        )
    if scheme.rest.fullmatch(rest) is None:
        raise ConfigError([ConfigIssue("--board", f"{uri!r}: {scheme.wanted}")])


def check_kind(uri: str, config: RigConfig) -> None:
    """Raise ConfigError unless the profile is made for the kind of board that `uri` names, and a real one for PCI."""
    name = uri.partition(":")[0]
    if name not in ("sim", config.board.kind):
        problem = f"{config.board.kind!r}, while the address {uri} is for boards of kind {name!r}; name another profile"
        raise ConfigError([ConfigIssue("board.kind", problem)])
    # the boards on USB tell a name, and the mock's is its own
    a_mocks = name != "pci" and set(config.board.application_names) <= set(MOCK_NAMES)
    if name != "sim" and config.board.simulated and not a_mocks:
        problem = f"the profile was made for the mock, and {uri} is a real board; inteco-abs probe makes one for it"
        raise ConfigError([ConfigIssue("board.simulated", problem)])


def check_limits(uri: str, config: RigConfig) -> None:
    """Raise ConfigError if the board at `uri` is a real one, and a limit of the guard is beyond what one may have."""
    mistakes = [] if simulated(uri) or config.board.simulated else list(beyond_ceilings(config))
    if mistakes:
        raise ConfigError(mistakes)


def default_profile(uri: str) -> str:
    """Name of the shipped profile to begin with for a board at `uri`."""
    return SCHEMES[uri.partition(":")[0]].profile


def simulated(uri: str) -> bool:
    """Whether the board at `uri` is the mock."""
    return uri.startswith("sim:")
