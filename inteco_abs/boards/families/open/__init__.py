"""The open board: frames with length, sequence number and CRC over a serial line or USB; it lets go by itself."""

from __future__ import annotations

import re
from typing import Final

from firmware_protocol import Logic, open_board
from firmware_protocol.fields import Value
from inteco_abs.boards.families.open.board import OpenBoard
from inteco_abs.boards.family import BoardFamily
from inteco_abs.boards.frame_labels import BoardProtocol
from inteco_abs.boards.transports.links import Link
from inteco_abs.config import RigConfig

__all__ = ["FAMILY", "OpenBoard"]

_LOGIC: Final = Logic(
    f"logic 0x{open_board.LOGIC_VERSION:04X}",
    (*open_board.COMMAND.payload, *open_board.REPORT.payload),
    open_board.REPORT.table,
    open_board.COMMAND.table,
    open_board.REPORT.table,
    open_board.HEAD_BYTES,
    open_board.QUERY.encode(),
)
"""The frames of a tick; the others are neither its commands nor its answers."""


class OpenProtocol(BoardProtocol):
    """Messages in which the board's name has a frame of its own."""

    def identity_in(self, answer: bytes) -> dict[str, Value] | None:
        """Return version and name of the logic from an IDENTITY. Raises ProtocolError for a damaged one."""
        if answer[1:2] != bytes([open_board.IDENTITY.kind]):
            return None
        values = open_board.IDENTITY.decode(answer)
        return {"logic_version": values["logic_version"], "application_name": values["name"]}


def _transport(path: str, config: RigConfig) -> Link:
    from inteco_abs.boards.families.open.line import FramedLine, only_port  # noqa: PLC0415  loads pyserial

    baud = config.board.baud
    return FramedLine(path or only_port(baud), baud)


FAMILY: Final = BoardFamily(
    name="open",
    title="open board",
    documentation="docs/open-board.md",
    address_meaning="an open board, by its serial port if there are several",
    address=re.compile(r"(/.+)?"),
    address_hint="after open: comes the path of a serial port, as in open:/dev/ttyACM0",
    profile="open_board",
    mock_profile="sim_open",
    transport=_transport,
    driver=OpenBoard,
    mock="inteco_abs.boards.families.open.mock:MOCK",
    host="inteco_abs.boards.families.open.host:HOST",
    protocols=(
        OpenProtocol("open-b01", f"open board, {_LOGIC.name}", open_board.LOGIC_VERSION, _LOGIC, {}, replays=False),
    ),
    unused_wiring=frozenset({"frame_map", "pwm_pins", "pwm_functions"}),
    fast_readings=True,
    tick_hz=tuple(
        rate for rate in range(open_board.TICK_HZ[0], open_board.TICK_HZ[1] + 1) if not open_board.CLOCK_HZ % rate
    ),
)
