"""The device layer: boards behind one interface, and the links to them."""

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
from inteco_abs.boards.authorization import read_only_reason, unconfirmed
from inteco_abs.boards.board import STILL_ON, Board, BoardReading, Identity, Reading
from inteco_abs.boards.family import (
    FAMILIES,
    BoardFamily,
    UsbTraffic,
    board_behind,
    check_pace,
    family_of,
    family_speaking,
    kind_check,
    known_families,
    protocol_name,
    protocol_of,
)
from inteco_abs.boards.first_write import PlannedWord, Remark
from inteco_abs.boards.frame_labels import (
    UNKNOWN,
    BoardProtocol,
    MessageRole,
    byte_offset,
    label,
    masks_of,
    names_at,
    words_of,
)
from inteco_abs.boards.transports.links import InProcessLink, Link, SocketLink, Wrap
from inteco_abs.boards.transports.registers import LinkedRegisters, Registers
from inteco_abs.config import RigConfig

__all__ = [
    "FAMILIES",
    "STILL_ON",
    "UNKNOWN",
    "Board",
    "BoardFamily",
    "BoardProtocol",
    "BoardReading",
    "Identity",
    "InProcessLink",
    "Link",
    "LinkedRegisters",
    "MessageRole",
    "PlannedWord",
    "Reading",
    "Registers",
    "Remark",
    "SocketLink",
    "UsbTraffic",
    "Wrap",
    "board_behind",
    "byte_offset",
    "check_address",
    "check_kind",
    "check_limits",
    "check_pace",
    "default_profile",
    "family_of",
    "family_speaking",
    "kind_check",
    "known_families",
    "label",
    "masks_of",
    "names_at",
    "open_board",
    "protocol_name",
    "protocol_of",
    "read_only_reason",
    "schemes",
    "simulated",
    "unconfirmed",
    "words_of",
]


def open_board(uri: str, config: RigConfig, now_ns: Callable[[], int], around: Wrap | None = None) -> Board:
    """Return the board at `uri`, not entered yet. `sim:PATH` is a mock board that listens at the socket PATH.

    `around` wraps the link, such as in a recording; boards with registers have none. Raises BoardError if nothing
    answers or another program has the board, ConfigError if the profile is for another family.
    """
    check_kind(uri, config)
    name, _, rest = uri.partition(":")
    carrier = SocketLink(rest) if name == SIMULATED else family_of(name).transport(rest, config)
    if around is not None and isinstance(carrier, Link):
        carrier = around(carrier)
    return board_behind(carrier, config, now_ns)
