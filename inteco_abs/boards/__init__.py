"""The device layer: boards behind one interface, and the links that carry their bytes."""

from collections.abc import Callable

from inteco_abs.boards.addresses import (
    SIMULATED,
    check_address,
    check_kind,
    check_limits,
    default_profile,
    schemes,
    simulated,
)
from inteco_abs.boards.authorization import unconfirmed
from inteco_abs.boards.board import STILL_ON, Board, BoardReading, Identity, Reading
from inteco_abs.boards.family import FAMILIES, BoardFamily, UsbTraffic, board_behind, family_of, known_families
from inteco_abs.boards.transports.links import InProcessLink, Link, SocketLink, Wrap
from inteco_abs.boards.transports.registers import LinkedRegisters, Registers
from inteco_abs.config import RigConfig

__all__ = [
    "FAMILIES",
    "STILL_ON",
    "Board",
    "BoardFamily",
    "BoardReading",
    "Identity",
    "InProcessLink",
    "Link",
    "LinkedRegisters",
    "Reading",
    "Registers",
    "SocketLink",
    "UsbTraffic",
    "Wrap",
    "board_behind",
    "check_address",
    "check_kind",
    "check_limits",
    "default_profile",
    "family_of",
    "known_families",
    "open_board",
    "schemes",
    "simulated",
    "unconfirmed",
]


def open_board(uri: str, config: RigConfig, now_ns: Callable[[], int], around: Wrap | None = None) -> Board:
    """The board at `uri`, not entered yet. `sim:PATH` is a mock board's process that listens at the socket PATH.

    `around` puts something around the link, such as a recording; registers have none. Raises BoardError if nothing
    answers there or another program has it, ConfigError if the profile is made for another family.
    """
    check_kind(uri, config)
    name, _, rest = uri.partition(":")
    carrier = SocketLink(rest) if name == SIMULATED else family_of(name).transport(rest, config)
    if around is not None and isinstance(carrier, Link):
        carrier = around(carrier)
    return board_behind(carrier, config, now_ns)
