"""The device layer: boards behind one interface, and the links that carry their bytes."""

from inteco_abs.boards.board import Board, Identity
from inteco_abs.boards.links import SCHEMES, InProcessLink, Link, check_address
from inteco_abs.boards.rtdac_usb2 import RtdacUsb2

__all__ = ["SCHEMES", "Board", "Identity", "InProcessLink", "Link", "RtdacUsb2", "check_address"]
