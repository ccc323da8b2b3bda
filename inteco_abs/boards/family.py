"""A board family in one record: everything that the program knows of it, and that no other place asks for by name.

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
    """How a USB monitor sees a board's messages."""

    endpoint_out: int
    endpoint_in: int
    sent_by: Callable[[int, bytes], bool]
    """Whether a bulk transfer at this endpoint with these data can only be this family's."""
    programming: tuple[int, ...] = ()
    """Endpoints that program the FPGA: left out of captures, and never replayed."""
    messages: str = ""
    """"module:attribute" of what makes whole messages of transfers, where transfers cut them; empty: each is one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFamily:
    """What the boards of one family have in common, whatever their logic."""

    name: str
    """Of its addresses, before the colon, and `board.kind` of its profiles."""
    title: str
    """As its maker calls it."""
    documentation: str
    """Where its users read on."""
    what: str
    """A board of it and what its address names, as in "an RT-DAC/USB2, by its decimal serial number"."""
    address: re.Pattern[str]
    """What may stand after the colon."""
    address_hint: str
    """The same in words."""
    profile: str
    """Of a real board, to begin with: a shipped one, or the path of a .toml file."""
    mock_profile: str
    """Of the mock board, likewise."""
    transport: Callable[[str, RigConfig], Link | Registers]
    """Opens what carries bytes to the board that the address names; raises BoardError."""
    driver: Callable[[Any, BoardConfig, Callable[[], int], int], Board]
    """The board behind what `transport` gives, or behind the link to its mock; with its wiring, a monotonic clock in ns
    and the period in ns. Raises ConfigError for a wiring that it has no channels for."""
    mock: str
    """"module:attribute" of its `inteco_abs.mock_board.MockFamily`; loaded by nothing but the mock board."""
    host: str
    """"module:attribute" of its `inteco_abs.host.HostFamily`: how the computer lists it, and what `doctor` checks."""
    protocols: tuple[BoardProtocol, ...] = ()
    """Of its logics whose frames are known; empty: it has registers, and no messages to record."""
    traffic: UsbTraffic | None = None
    """How Wireshark's captures are read; None: they are not."""
    says_name: bool = True
    """Whether its header has the name of the logic, by which a profile can tell the mock from a real board."""
    unused_wiring: frozenset[str] = frozenset()
    """Keys of the wiring that mean nothing here."""
    read_costs_little: bool = False
    """Whether a whole reading fits into a period, so that a screen shows one while outputs are on."""
    velocity: str = ""
    """Name, among `Board.readings`, of the road wheel's velocity as the board measures it, in rpm."""
    reading_caution: str = ""
    """What reading a board of it may disturb."""
    bridge_facts: Callable[[str, RigConfig], dict[str, str]] = field(default=lambda _rest, _config: {})
    """What the bridge on the way to the board tells besides frames; the address's part after the colon comes first."""
    identify_led: Callable[[str, RigConfig, bool], bool] | None = None
    """Switches an LED to show which board it is; gives False if the board refuses."""


def _require_family(path: str, found: object, name: str) -> BoardFamily:
    if not isinstance(found, BoardFamily):
        raise ConfigError([ConfigIssue(path, f"{name} is not an inteco_abs.boards.BoardFamily")])
    return found


FAMILIES: Final = Registry("a board family", "inteco_abs.board_families", "board.kind", SHIPPED, _require_family)
"""Every family by name, loaded when it is used."""


def known_families() -> dict[str, BoardFamily]:
    """Every family that can be used, by name."""
    return {name: family for name, (family, _) in FAMILIES.usable()[0].items()}


def kind_check(table: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    """Check for `load_config`: `board.kind` must be a known family."""
    kind = section_of(table, "board").get("kind")
    if isinstance(kind, str) and kind not in FAMILIES:
        yield _unknown(kind)


def _unknown(kind: str) -> ConfigIssue:
    return ConfigIssue("board.kind", f"no board family {kind!r}; known: {', '.join(sorted(FAMILIES))}")


def family_of(kind: str) -> BoardFamily:
    """The family that a profile's `board.kind` names; raises ConfigError if there is none."""
    if kind not in FAMILIES:
        raise ConfigError([_unknown(kind)])
    family = FAMILIES[kind]
    if family.name != kind:
        raise ConfigError([ConfigIssue("board.kind", f"{kind!r}: its record says {family.name!r}; mend its package")])
    return family


def board_behind(link: Link | Registers, config: RigConfig, now_ns: Callable[[], int]) -> Board:
    """The profile's board at the far end of `link`, not entered yet."""
    return family_of(config.board.kind).driver(link, config.board, now_ns, config.period_ns)


def protocols() -> dict[str, BoardProtocol]:
    """The protocols of all families, by the board that a capture names."""
    return {one.board: one for family in known_families().values() for one in family.protocols}


def protocol_of(board: str, option: str = "board") -> BoardProtocol:
    """Protocol of that name. Raises ConfigError that blames `option` if there is none."""
    known = protocols()
    if board not in known:
        raise ConfigError([ConfigIssue(option, f"no protocol {board!r}{near_match(board, known)}")])
    return known[board]


def protocol_name(wiring: BoardConfig) -> str:
    """Which protocol the board of a profile speaks; raises ConfigError if it speaks none."""
    family = family_of(wiring.kind)
    for one in family.protocols:
        if all(getattr(wiring, key) == value for key, value in one.settings.items()):
            return one.board
    keys = dict.fromkeys(key for one in family.protocols for key in one.settings)
    stated = " with " + ", ".join(f"{key} = {getattr(wiring, key)!r}" for key in keys) if keys else ""
    raise ConfigError([ConfigIssue("board", f"no messages of {family.title}{stated} are known")])


def family_speaking(board: str, option: str = "board") -> BoardFamily:
    """The family whose boards speak the protocol `board`. Raises ConfigError that blames `option`."""
    protocol = protocol_of(board, option)
    return next(family for family in known_families().values() if protocol in family.protocols)
