"""Driver of the RT-DAC/USB2: a tick is SEND, READ request and READ answer."""

from __future__ import annotations

import struct
from typing import Final

from firmware_protocol.pwm import PWM_FULL_WIDTH
from firmware_protocol.rtdac_usb2 import HEADER_BYTES, LOGICS, READ_REQUEST, Logic
from inteco_abs.boards.frame_board import FrameBoard, FrameLayout
from inteco_abs.config import BoardConfig


def _layout(logic: Logic) -> FrameLayout:
    return FrameLayout(
        read=logic.read,
        send=logic.send,
        header=logic.read,
        header_bytes=HEADER_BYTES,
        request=READ_REQUEST,
        pwm_full_width=PWM_FULL_WIDTH,
        number=struct.Struct("<H"),
        number_bits=15,
    )


LAYOUTS: Final = {name: _layout(logic) for name, logic in LOGICS.items()}


class RtdacUsb2(FrameBoard):
    """Driver of an RT-DAC/USB2 with the frames of the profile's logic."""

    def _layout_of(self, wiring: BoardConfig) -> FrameLayout:
        return LAYOUTS[wiring.frame_map]
