"""The device layer: boards behind one interface, and the links that carry their bytes."""

from collections.abc import Callable
from typing import Final

from inteco_abs.boards.board import STILL_ON, Board, Identity
from inteco_abs.boards.links import SCHEMES, InProcessLink, Link, SocketLink, check_address, simulated
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
    "simulated",
]


def open_board(uri: str, config: RigConfig, now_ns: Callable[[], int]) -> Board:
    """The board at `uri`, not entered yet. `sim:PATH` is a mock board's process that listens at the socket PATH.

    Raises BoardError if nothing answers there or another program has it.
    """
    scheme, _, rest = uri.partition(":")
    return RtdacUsb2(_OPENERS[scheme](rest, config), config.board, now_ns, config.period_ns)


def _open_socket(path: str, _: RigConfig) -> Link:
    return SocketLink(path)


def _open_usb(serial: str, config: RigConfig) -> Link:
    from inteco_abs.boards.usb_engines import open_usb  # noqa: PLC0415  who has no such board needs no libusb

    return open_usb(serial, config.usb)


_OPENERS: Final[dict[str, Callable[[str, RigConfig], Link]]] = {"sim": _open_socket, "usb2": _open_usb}
