"""The board's own side: answers real frames, with the physics of the rig inside."""

from collections.abc import Callable
from typing import Final

from inteco_abs.mock_board.device import Cable, Device, Truth
from inteco_abs.mock_board.faults import (
    BY_PROCESS,
    CLOCK_STEP,
    KINDS,
    ON_THE_HOST,
    Event,
    Fault,
    FaultyDevice,
    FaultyFrontEnd,
    FaultyHost,
    Schedule,
    parse_faults,
    require_possible,
)
from inteco_abs.mock_board.frontend import FrontEnd
from inteco_abs.mock_board.frontends.pci import PciFrontEnd
from inteco_abs.mock_board.frontends.usb import ByteStream, UsbFrontEnd
from inteco_abs.mock_board.frontends.usb2 import Usb2FrontEnd
from inteco_abs.mock_board.pty_board import PtyServer
from inteco_abs.mock_board.reported_board import ReportedFrontEnd, ReportedIdentity
from inteco_abs.mock_board.simulated_rig import drawn_facts, rig_check, simulated_rig
from inteco_abs.mock_board.socket_server import SocketServer
from inteco_abs.mock_board.truth_log import TruthLog
from inteco_abs.mock_board.usbip.address import TcpAddress, UnixAddress, parse_address
from inteco_abs.mock_board.usbip.ftdi import FtdiBoard, ftdi_identity
from inteco_abs.mock_board.usbip.server import Facts, UsbIpServer
from inteco_abs.mock_board.usbip.usb_board import UsbBoard
from inteco_abs.mock_board.usbip.usb_descriptors import Speed, UsbIdentity
from inteco_abs.mock_board.usbip.usb_host import Urb, UsbHost

__all__ = [
    "BY_PROCESS",
    "CLOCK_STEP",
    "KINDS",
    "ON_THE_HOST",
    "ByteStream",
    "Cable",
    "Device",
    "Event",
    "Facts",
    "Fault",
    "FaultyDevice",
    "FaultyFrontEnd",
    "FaultyHost",
    "FrontEnd",
    "FtdiBoard",
    "PciFrontEnd",
    "PtyServer",
    "ReportedFrontEnd",
    "ReportedIdentity",
    "Schedule",
    "SocketServer",
    "Speed",
    "TcpAddress",
    "Truth",
    "TruthLog",
    "UnixAddress",
    "Urb",
    "Usb2FrontEnd",
    "UsbBoard",
    "UsbFrontEnd",
    "UsbHost",
    "UsbIdentity",
    "UsbIpServer",
    "drawn_facts",
    "face_of",
    "ftdi_identity",
    "parse_address",
    "parse_faults",
    "require_possible",
    "rig_check",
    "simulated_rig",
]

_FACES: Final[dict[str, Callable[[Device], FrontEnd]]] = {"usb2": Usb2FrontEnd, "usb": UsbFrontEnd, "pci": PciFrontEnd}


def face_of(device: Device) -> FrontEnd:
    """What a host sees of `device`: messages in, messages out, as its kind of board has them."""
    return _FACES[device.kind](device)
