"""The device layer: boards behind one interface, and the links that carry their bytes."""

from collections.abc import Callable

from inteco_abs.boards.board import STILL_ON, Board, Identity
from inteco_abs.boards.links import SCHEMES, InProcessLink, Link, SocketLink, check_address
from inteco_abs.boards.rtdac_usb2 import RtdacUsb2
from inteco_abs.config import RigConfig

__all__ = [
    "SCHEMES",
    "STILL_ON",
    "Board",
    "Identity",
    "InProcessLink",
    "Link",
    "RtdacUsb2",
    "SocketLink",
    "check_address",
    "open_board",
]


def open_board(uri: str, config: RigConfig, now_ns: Callable[[], int]) -> Board:
    """The board at `uri`, not entered yet. `sim:PATH` is a mock board's process that listens at the socket PATH.

    Raises BoardError if nothing answers there or another program has it.
    """
    return RtdacUsb2(SocketLink(uri.partition(":")[2]), config.board, now_ns, config.period_ns)
