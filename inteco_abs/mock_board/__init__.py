"""Mock boards, which answer the real protocols and contain the simulated rig."""

from inteco_abs.mock_board.device import MAXIMUM_CELSIUS, MINIMUM_SUPPLY_V, Cable, Device, Truth
from inteco_abs.mock_board.family import Connected, MockFamily, always_connected, front_end_of, mock_family
from inteco_abs.mock_board.faults import (
    BY_PROCESS,
    CLOCK_STEP,
    KINDS,
    ON_THE_HOST,
    Fault,
    FaultEvent,
    FaultyDevice,
    FaultyFrontEnd,
    FaultyHost,
    Schedule,
    parse_faults,
    require_possible,
)
from inteco_abs.mock_board.frame_answer import AnswerConstants, AnswerState, give_counts, take_command
from inteco_abs.mock_board.frontend import FrontEnd, Stream, require_terminals
from inteco_abs.mock_board.pty_board import PtyServer
from inteco_abs.mock_board.reported_board import ReportedFrontEnd, ReportedIdentity, reported_frames
from inteco_abs.mock_board.simulated_rig import drawn_facts, rig_check, simulated_rig
from inteco_abs.mock_board.socket_server import SocketServer
from inteco_abs.mock_board.truth_log import TruthLog
from inteco_abs.mock_board.usbip.address import TcpAddress, UnixAddress, parse_address
from inteco_abs.mock_board.usbip.ftdi import FtdiBoard, ftdi_identity
from inteco_abs.mock_board.usbip.server import AttachFacts, UsbIpServer
from inteco_abs.mock_board.usbip.usb_board import UsbBoard
from inteco_abs.mock_board.usbip.usb_descriptors import UsbIdentity, UsbSpeed
from inteco_abs.mock_board.usbip.usb_host import Urb, UsbHost

__all__ = [
    "BY_PROCESS",
    "CLOCK_STEP",
    "KINDS",
    "MAXIMUM_CELSIUS",
    "MINIMUM_SUPPLY_V",
    "ON_THE_HOST",
    "AnswerConstants",
    "AnswerState",
    "AttachFacts",
    "Cable",
    "Connected",
    "Device",
    "Fault",
    "FaultEvent",
    "FaultyDevice",
    "FaultyFrontEnd",
    "FaultyHost",
    "FrontEnd",
    "FtdiBoard",
    "MockFamily",
    "PtyServer",
    "ReportedFrontEnd",
    "ReportedIdentity",
    "Schedule",
    "SocketServer",
    "Stream",
    "TcpAddress",
    "Truth",
    "TruthLog",
    "UnixAddress",
    "Urb",
    "UsbBoard",
    "UsbHost",
    "UsbIdentity",
    "UsbIpServer",
    "UsbSpeed",
    "always_connected",
    "drawn_facts",
    "front_end_of",
    "ftdi_identity",
    "give_counts",
    "mock_family",
    "parse_address",
    "parse_faults",
    "reported_frames",
    "require_possible",
    "require_terminals",
    "rig_check",
    "simulated_rig",
    "take_command",
]
