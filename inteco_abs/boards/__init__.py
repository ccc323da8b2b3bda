"""The device layer: boards behind one interface, and the links that carry their bytes."""

from collections.abc import Callable
from typing import Final

from inteco_abs.boards.addresses import SCHEMES, check_address, check_kind, check_limits, default_profile, simulated
from inteco_abs.boards.board import STILL_ON, Board, BoardReading, Identity
from inteco_abs.boards.families.pci.board import Reading, RtdacPci
from inteco_abs.boards.families.usb.board import RtdacUsb
from inteco_abs.boards.families.usb2.board import RtdacUsb2
from inteco_abs.boards.transports.links import InProcessLink, Link, SocketLink, Wrap
from inteco_abs.boards.transports.registers import LinkedRegisters, Registers
from inteco_abs.boards.transports.sysfs import SysfsRegisters
from inteco_abs.config import BoardConfig, RigConfig

__all__ = [
    "SCHEMES",
    "STILL_ON",
    "Board",
    "BoardReading",
    "Identity",
    "InProcessLink",
    "Link",
    "LinkedRegisters",
    "Reading",
    "Registers",
    "RtdacPci",
    "RtdacUsb",
    "RtdacUsb2",
    "SocketLink",
    "SysfsRegisters",
    "Wrap",
    "board_behind",
    "check_address",
    "check_kind",
    "check_limits",
    "default_profile",
    "open_board",
    "simulated",
]

_KINDS: Final[dict[str, Callable[[Link, BoardConfig, Callable[[], int], int], Board]]] = {
    "usb2": RtdacUsb2,
    "usb": RtdacUsb,
    "pci": lambda link, wiring, now_ns, period_ns: RtdacPci(LinkedRegisters(link), wiring, now_ns, period_ns),
}


def open_board(uri: str, config: RigConfig, now_ns: Callable[[], int], around: Wrap | None = None) -> Board:
    """The board at `uri`, not entered yet. `sim:PATH` is a mock board's process that listens at the socket PATH.

    `around` puts something around the link, such as a recording; a board on the PCI bus has none. Raises BoardError if
    nothing answers there or another program has it, ConfigError if the profile is made for another kind of board.
    """
    check_kind(uri, config)
    scheme, _, rest = uri.partition(":")
    if scheme == "pci":
        return RtdacPci(SysfsRegisters(rest), config.board, now_ns, config.period_ns)
    link = _OPENERS[scheme](rest, config)
    return board_behind(around(link) if around else link, config, now_ns)


def board_behind(link: Link, config: RigConfig, now_ns: Callable[[], int]) -> Board:
    """The profile's board at the far end of `link`, not entered yet."""
    return _KINDS[config.board.kind](link, config.board, now_ns, config.period_ns)


def _open_socket(path: str, _: RigConfig) -> Link:
    return SocketLink(path)


def _open_usb2(serial: str, config: RigConfig) -> Link:
    from inteco_abs.boards.transports.usb_transport import open_usb  # noqa: PLC0415  who has no such board needs no libusb

    return open_usb(serial, config.usb)


def _open_serial(path: str, _: RigConfig) -> Link:
    from inteco_abs.boards.transports.serial_link import SerialLink  # noqa: PLC0415  who has no such board needs no pyserial
    from inteco_abs.boards.transports.serial_ports import only_port  # noqa: PLC0415  likewise

    return SerialLink(path or only_port())


_OPENERS: Final[dict[str, Callable[[str, RigConfig], Link]]] = {
    "sim": _open_socket,
    "usb2": _open_usb2,
    "usb": _open_serial,
}
