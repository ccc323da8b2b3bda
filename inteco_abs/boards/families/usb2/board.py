"""Driver of the RT-DAC/USB2: a tick is SEND, READ request and READ answer."""

from __future__ import annotations

from firmware_protocol import Logic
from firmware_protocol.rtdac_usb2 import LOGICS
from inteco_abs.boards.frame_board import FrameBoard
from inteco_abs.config import BoardConfig


class RtdacUsb2(FrameBoard):
    """Driver of an RT-DAC/USB2 with the frames of the profile's logic."""

    def _logic_of(self, wiring: BoardConfig) -> Logic:
        return LOGICS[wiring.frame_map]
