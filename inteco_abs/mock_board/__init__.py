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
    FaultyFace,
    FaultyHost,
    Schedule,
    insist_on_possible,
    parse_faults,
)
from inteco_abs.mock_board.frontend import Face
from inteco_abs.mock_board.frontends.pci import PciFace
from inteco_abs.mock_board.frontends.usb import ByteStream, UsbFace
from inteco_abs.mock_board.frontends.usb2 import Usb2Face
from inteco_abs.mock_board.pty_board import PtyServer
from inteco_abs.mock_board.reported_board import SeenFace, SeenIdentity
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
    "Face",
    "Facts",
    "Fault",
    "FaultyDevice",
    "FaultyFace",
    "FaultyHost",
    "FtdiBoard",
    "PciFace",
    "PtyServer",
    "Schedule",
    "SeenFace",
    "SeenIdentity",
    "SocketServer",
    "Speed",
    "TcpAddress",
    "Truth",
    "TruthLog",
    "UnixAddress",
    "Urb",
    "Usb2Face",
    "UsbBoard",
    "UsbFace",
    "UsbHost",
    "UsbIdentity",
    "UsbIpServer",
    "drawn_facts",
    "face_of",
    "ftdi_identity",
    "insist_on_possible",
    "parse_address",
    "parse_faults",
    "rig_check",
    "simulated_rig",
]

_FACES: Final[dict[str, Callable[[Device], Face]]] = {"usb2": Usb2Face, "usb": UsbFace, "pci": PciFace}


def face_of(device: Device) -> Face:
    """What a host sees of `device`: messages in, messages out, as its kind of board has them."""
    return _FACES[device.kind](device)
