"""Driver of the first RT-DAC/USB: frames of 150 bytes through a FIFO, for logics 0x0111 and 0x0112.

A tick takes some milliseconds, as each answer waits in the bridge's FIFO for its latency timer.
"""

from __future__ import annotations

import struct
from typing import Final

from firmware_protocol.pwm import PWM_FULL_WIDTH
from firmware_protocol.rtdac_usb import HEADER, HEADER_BYTES, LOGICS, READ_REQUEST, Logic
from inteco_abs.boards.frame_board import FrameBoard, FrameLayout
from inteco_abs.config import BoardConfig
from inteco_abs.errors import ConfigError, ConfigIssue


def _layout(logic: Logic) -> FrameLayout:
    return FrameLayout(
        read=logic.read,
        send=logic.send,
        header=HEADER,
        header_bytes=HEADER_BYTES,
        request=READ_REQUEST,
        pwm_full_width=PWM_FULL_WIDTH,
        number=struct.Struct("<B"),
        number_bits=7,
    )


LAYOUTS: Final = {version: _layout(logic) for version, logic in LOGICS.items()}


class RtdacUsb(FrameBoard):
    """Driver of an RT-DAC/USB with the profile's logic."""

    def _layout_of(self, wiring: BoardConfig) -> FrameLayout:
        layout = LAYOUTS.get(wiring.logic_version)
        if layout is None:
            known = ", ".join(f"0x{version:04X}" for version in LAYOUTS)
            problem = f"0x{wiring.logic_version:04X}: the known logics of an RT-DAC/USB are {known}"
            raise ConfigError([ConfigIssue("board.logic_version", problem)])
        return layout
