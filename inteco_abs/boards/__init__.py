"""The device layer: boards behind one interface, and the links that carry their bytes."""

from collections.abc import Callable
from typing import Final

from inteco_abs.boards.addresses import SCHEMES, check_address, check_kind, default_profile, simulated
from inteco_abs.boards.board import STILL_ON, Board, Identity, Survey
from inteco_abs.boards.frames import FrameBoard
from inteco_abs.boards.links import InProcessLink, Link, SocketLink
from inteco_abs.boards.recording_link import Wrap, recording
from inteco_abs.boards.rtdac_usb import RtdacUsb
from inteco_abs.boards.rtdac_usb2 import RtdacUsb2
from inteco_abs.config import RigConfig

__all__ = [
    "SCHEMES",
    "STILL_ON",
    "Board",
    "Identity",
    "InProcessLink",
    "Link",
    "RtdacUsb",
    "RtdacUsb2",
    "SocketLink",
    "Survey",
    "Wrap",
    "board_behind",
    "check_address",
    "check_kind",
    "default_profile",
    "open_board",
    "recording",
    "simulated",
]

_KINDS: Final[dict[str, type[FrameBoard]]] = {"usb2": RtdacUsb2, "usb": RtdacUsb}


def open_board(uri: str, config: RigConfig, now_ns: Callable[[], int], around: Wrap | None = None) -> Board:
    """The board at `uri`, not entered yet. `sim:PATH` is a mock board's process that listens at the socket PATH.

    `around` puts something around the link, such as a recording. Raises BoardError if nothing answers there or
    another program has it, ConfigError if the profile is made for another kind of board.
    """
    check_kind(uri, config)
    scheme, _, rest = uri.partition(":")
    link = _OPENERS[scheme](rest, config)
    return board_behind(around(link) if around else link, config, now_ns)


def board_behind(link: Link, config: RigConfig, now_ns: Callable[[], int]) -> Board:
    """The profile's board at the far end of `link`, not entered yet."""
    return _KINDS[config.board.kind](link, config.board, now_ns, config.period_ns)


def _open_socket(path: str, _: RigConfig) -> Link:
    return SocketLink(path)


def _open_usb2(serial: str, config: RigConfig) -> Link:
    from inteco_abs.boards.usb_engines import open_usb  # noqa: PLC0415  who has no such board needs no libusb

    return open_usb(serial, config.usb)


_OPENERS: Final[dict[str, Callable[[str, RigConfig], Link]]] = {"sim": _open_socket, "usb2": _open_usb2}
