"""The board's own side: answers real frames, with the physics of the rig inside."""

from inteco_abs.mock_board.device import Cable, Device, Truth
from inteco_abs.mock_board.serve import SocketServer
from inteco_abs.mock_board.usb2 import Usb2Face

__all__ = ["Cable", "Device", "SocketServer", "Truth", "Usb2Face"]
