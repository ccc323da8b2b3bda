"""The record of a board family; no other code compares a family's name.

`inteco_abs/boards/families` has one folder for each family that ships; an installed package adds one as an entry point
of the group `inteco_abs.board_families` (docs/how-to/add-a-board-family.md).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from inteco_abs.boards.board import Board
from inteco_abs.boards.families import SHIPPED
from inteco_abs.boards.frame_labels import BoardProtocol
from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.registers import Registers
from inteco_abs.config import BoardConfig, RigConfig, section_of
from inteco_abs.entry_points import Registry
from inteco_abs.errors import ConfigError, ConfigIssue, near_match


class UsbTraffic(NamedTuple):
    """A board's messages in the capture of a USB monitor."""

    endpoint_out: int
    endpoint_in: int
    sent_by: Callable[[int, bytes], bool]
    """Whether a bulk transfer at this endpoint with these data identifies this family."""
    programming: tuple[int, ...] = ()
    """Endpoints that program the FPGA: left out of captures, and never replayed."""
    messages: str = ""
    """"module:attribute" of a function that joins transfers into messages; empty if each transfer is a message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFamily:
    """The properties that all boards of a family share."""

    name: str
    """The scheme of its addresses, and `board.kind` of its profiles."""
    title: str
    """The maker's name for it."""
    documentation: str
    """Page for its users."""
    address_meaning: str
    """The board and what its address names, as in "an RT-DAC/USB2, by its decimal serial number"."""
    address: re.Pattern[str]
    """Form of an address after the colon."""
    address_hint: str
    """Description of that form for an error message."""
    profile: str
    """Default profile of a real board: a shipped one, or the path of a .toml file."""
    mock_profile: str
    """Default profile of the mock board, likewise."""
    transport: Callable[[str, RigConfig], Link | Registers]
    """Opens the link or the registers of the board at an address; raises BoardError."""
    driver: Callable[[Any, BoardConfig, Callable[[], int], int], Board]
    """Makes the board of a transport, or of a link to its mock; takes its wiring, a monotonic clock in ns and the
    period in ns. Raises ConfigError for a wiring with missing channels."""
    mock: str
    """"module:attribute" of its `inteco_abs.mock_board.MockFamily`; only the mock board loads it."""
    host: str
    """"module:attribute" of its `inteco_abs.host.HostFamily`: how to list boards, and what `doctor` checks."""
    protocols: tuple[BoardProtocol, ...] = ()
    """Protocols of the logics with known frames; empty for a board with registers, which has no messages to record."""
    traffic: UsbTraffic | None = None
    """How to read Wireshark captures; None if they cannot be read."""
    reports_name: bool = True
    """Whether its header contains the name of the logic, which distinguishes the mock from a real board."""
    unused_wiring: frozenset[str] = frozenset()
    """Keys of the wiring without effect."""
    fast_readings: bool = False
    """Whether `Board.readings` fits into a period, so that a screen may show it while outputs are on."""
    tick_hz: tuple[int, ...] = ()
    """Rates at which a board's own tick can pace the loop; empty: it has none."""
    velocity: str = ""
    """Name, among `Board.readings`, of the road wheel's velocity as the board measures it, in rpm."""
    reading_caution: str = ""
    """Warning about side effects of reading a board; empty if there are none."""
    bridge_facts: Callable[[str, RigConfig], dict[str, str]] = field(default=lambda _rest, _config: {})
    """Facts that the board's USB bridge reports, for the address after the colon."""
    identify_led: Callable[[str, RigConfig, bool], bool] | None = None
    """Switches an LED to identify a board; returns False if the board rejects the request."""


def _require_family(path: str, found: object, name: str) -> BoardFamily:
    if not isinstance(found, BoardFamily):
        raise ConfigError([ConfigIssue(path, f"{name} is not an inteco_abs.boards.BoardFamily")])
    return found


FAMILIES: Final = Registry("a board family", "inteco_abs.board_families", "board.kind", SHIPPED, _require_family)
"""Every family by name, loaded on use."""


def known_families() -> dict[str, BoardFamily]:
    """Return every usable family by name."""
    return {name: family for name, (family, _) in FAMILIES.usable()[0].items()}


def kind_check(table: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    """Check for `load_config`: `board.kind` must be a known family."""
    kind = section_of(table, "board").get("kind")
    if isinstance(kind, str) and kind not in FAMILIES:
        yield _unknown(kind)


def _unknown(kind: str) -> ConfigIssue:
    return ConfigIssue("board.kind", f"no board family {kind!r}; known: {', '.join(sorted(FAMILIES))}")


def family_of(kind: str) -> BoardFamily:
    """Return the family that `board.kind` names; raises ConfigError if there is none."""
    if kind not in FAMILIES:
        raise ConfigError([_unknown(kind)])
    family = FAMILIES[kind]
    if family.name != kind:
        raise ConfigError(
            [ConfigIssue("board.kind", f"{kind!r}: its record has the name {family.name!r}; fix its package")]
        )
    return family


def check_pace(config: RigConfig) -> None:
    """Raise ConfigError if the board's tick has to pace the loop, and cannot."""
    family = family_of(config.board.kind)
    if config.loop.pace != "board" or config.loop.rate_hz in family.tick_hz:
        return
    if not family.tick_hz:
        raise ConfigError.of("loop.pace", f"'board': {family.title} has no tick; set it to computer")
    rates = ", ".join(map(str, family.tick_hz))
    raise ConfigError.of(
        "loop.rate_hz", f"{config.loop.rate_hz:g}: the tick of {family.title} has the rates {rates} Hz"
    )


def board_behind(link: Link | Registers, config: RigConfig, now_ns: Callable[[], int]) -> Board:
    """Return the profile's board at the far end of `link`, not entered yet."""
    return family_of(config.board.kind).driver(link, config.board, now_ns, config.period_ns)


def protocols() -> dict[str, BoardProtocol]:
    """Return the protocols of all families, by the board that a capture names."""
    return {one.board: one for family in known_families().values() for one in family.protocols}


def protocol_of(board: str, option: str = "board") -> BoardProtocol:
    """Return the protocol of that name. Raises ConfigError naming `option` if there is none."""
    known = protocols()
    if board not in known:
        raise ConfigError([ConfigIssue(option, f"no protocol {board!r}{near_match(board, known)}")])
    return known[board]


def protocol_name(wiring: BoardConfig) -> str:
    """Return the name of the protocol of a profile's board; raises ConfigError if there is none."""
    family = family_of(wiring.kind)
    for one in family.protocols:
        if all(getattr(wiring, key) == value for key, value in one.settings.items()):
            return one.board
    keys = dict.fromkeys(key for one in family.protocols for key in one.settings)
    stated = " with " + ", ".join(f"{key} = {getattr(wiring, key)!r}" for key in keys) if keys else ""
    raise ConfigError([ConfigIssue("board", f"the messages of {family.title}{stated} are not known")])


def family_speaking(board: str, option: str = "board") -> BoardFamily:
    """Return the family with the protocol `board`. Raises ConfigError naming `option` if there is none."""
    protocol = protocol_of(board, option)
    return next(family for family in known_families().values() if protocol in family.protocols)
