"""RT-DAC/USB2: SEND, READ request and READ answer, one after the other in each tick."""

from __future__ import annotations

import struct
from typing import Final

from firmware_protocol.rtdac_usb2 import HEADER_BYTES, PWM_CHANNELS, PWM_FULL_WIDTH, READ, READ_REQUEST, SEND
from inteco_abs.boards.frames import FrameBoard, FrameLayout
from inteco_abs.config import BoardConfig

LAYOUT: Final = FrameLayout(
    read=READ,
    send=SEND,
    header=READ,
    header_bytes=HEADER_BYTES,
    request=READ_REQUEST,
    pwm_channels=PWM_CHANNELS,
    pwm_full_width=PWM_FULL_WIDTH,
    number=struct.Struct("<H"),
    number_bits=15,
)


class RtdacUsb2(FrameBoard):
    """An RT-DAC/USB2 with the generic logic's frames, the only ones that are published for this board."""

    def _layout_of(self, _wiring: BoardConfig) -> FrameLayout:
        return LAYOUT
