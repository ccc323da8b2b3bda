"""Driver of the first RT-DAC/USB: frames of 150 bytes through a FIFO, for logics 0x0111 and 0x0112.

A tick takes some milliseconds, as each answer waits in the bridge's FIFO for its latency timer.
"""

from __future__ import annotations

from firmware_protocol import Logic
from firmware_protocol.rtdac_usb import LOGICS
from inteco_abs.boards.frame_board import FrameBoard
from inteco_abs.config import BoardConfig
from inteco_abs.errors import ConfigError, ConfigIssue


class RtdacUsb(FrameBoard):
    """Driver of an RT-DAC/USB with the profile's logic."""

    def _logic_of(self, wiring: BoardConfig) -> Logic:
        logic = LOGICS.get(wiring.logic_version)
        if logic is None:
            known = ", ".join(f"0x{version:04X}" for version in LOGICS)
            problem = f"0x{wiring.logic_version:04X}: the known logics of an RT-DAC/USB are {known}"
            raise ConfigError([ConfigIssue("board.logic_version", problem)])
        return logic
