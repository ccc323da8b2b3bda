"""RT-DAC/USB, first generation: frames of 150 bytes through an FTDI chip."""

from __future__ import annotations

import re
from typing import Final

from firmware_protocol import Logic
from firmware_protocol.rtdac_usb import LOGICS
from inteco_abs.boards.families.usb.board import RtdacUsb
from inteco_abs.boards.family import BoardFamily, UsbTraffic
from inteco_abs.boards.frame_labels import BoardProtocol
from inteco_abs.boards.transports.links import Link
from inteco_abs.config import RigConfig

__all__ = ["FAMILY", "RtdacUsb"]

_FTDI_OUT, _FTDI_IN = 0x02, 0x81


def _protocol(version: int, logic: Logic) -> BoardProtocol:
    title = f"RT-DAC/USB, logic 0x{version:04X}"
    return BoardProtocol(f"usb1-{version:x}", title, version, logic, {"logic_version": version})


def _transport(path: str, _: RigConfig) -> Link:
    from inteco_abs.boards.transports.serial_link import SerialLink  # noqa: PLC0415  loads pyserial
    from inteco_abs.boards.transports.serial_ports import only_port  # noqa: PLC0415  likewise

    return SerialLink(path or only_port())


FAMILY: Final = BoardFamily(
    name="usb",
    title="RT-DAC/USB",
    documentation="docs/boards.md",
    address_meaning="an RT-DAC/USB of the first generation, by its serial port if there are several",
    address=re.compile(r"(/.+)?"),
    address_hint="after usb: comes the path of a serial port, as in usb:/dev/ttyUSB0",
    profile="usb1_0111",
    mock_profile="sim_usb",
    transport=_transport,
    driver=RtdacUsb,
    mock="inteco_abs.boards.families.usb.mock:MOCK",
    host="inteco_abs.boards.families.usb.host:HOST",
    protocols=tuple(_protocol(version, logic) for version, logic in LOGICS.items()),
    traffic=UsbTraffic(
        _FTDI_OUT,
        _FTDI_IN,
        lambda endpoint, data: endpoint == _FTDI_OUT and data[:1] in {b"\x80", b"\x81", b"\x82"},
        messages="inteco_abs.wire.byte_stream:whole_messages",
    ),
    unused_wiring=frozenset({"frame_map"}),
)
