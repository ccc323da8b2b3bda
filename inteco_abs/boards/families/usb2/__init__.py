"""RT-DAC/USB2: frames of 504 bytes over USB, in the words of the generic logic or of a rig's."""

from __future__ import annotations

import re
from typing import Final

from firmware_protocol import Logic
from firmware_protocol.rtdac_usb2 import (
    ENDPOINT_IN,
    ENDPOINT_OUT,
    FRAME_BYTES,
    LOGIC_VERSION,
    LOGICS,
)
from firmware_protocol.rtdac_usb2_bridge import ENDPOINT_JTAG_IN, ENDPOINT_JTAG_OUT
from inteco_abs.boards.families.usb2.board import RtdacUsb2
from inteco_abs.boards.family import BoardFamily, UsbTraffic
from inteco_abs.boards.frame_labels import BoardProtocol
from inteco_abs.boards.transports.links import Link
from inteco_abs.config import RigConfig

__all__ = ["FAMILY", "RtdacUsb2"]


def _protocol(logic: Logic) -> BoardProtocol:
    generic = logic.name == "generic"
    return BoardProtocol(
        "usb2" if generic else f"usb2-{logic.name}",
        f"RT-DAC/USB2, logic 0x{LOGIC_VERSION:04X}" if generic else f"RT-DAC/USB2, {logic.name} logic",
        LOGIC_VERSION if generic else None,
        logic,
        {"frame_map": logic.name},
    )


def _transport(serial: str, config: RigConfig) -> Link:
    from inteco_abs.boards.transports.usb_transport import open_usb  # noqa: PLC0415  loads pyusb

    return open_usb(serial, config.usb)


def _bridge_facts(serial: str, config: RigConfig) -> dict[str, str]:
    from inteco_abs.boards.families.usb2.bridge import bridge_facts  # noqa: PLC0415  likewise
    from inteco_abs.boards.transports.usb import find_usb_board  # noqa: PLC0415  likewise

    return bridge_facts(find_usb_board(serial, config.usb))


def _identify_led(serial: str, config: RigConfig, on: bool) -> bool:
    from inteco_abs.boards.families.usb2.bridge import identify_led  # noqa: PLC0415  likewise
    from inteco_abs.boards.transports.usb import find_usb_board  # noqa: PLC0415  likewise

    return identify_led(find_usb_board(serial, config.usb), on=on)


FAMILY: Final = BoardFamily(
    name="usb2",
    title="RT-DAC/USB2",
    documentation="docs/boards.md",
    address_meaning="an RT-DAC/USB2, by its decimal serial number if there are several",
    address=re.compile(r"[0-9]*"),
    address_hint="after usb2: comes a decimal serial number, as in usb2:123",
    profile="usb2_generic_0103",
    mock_profile="sim_usb2",
    transport=_transport,
    driver=RtdacUsb2,
    mock="inteco_abs.boards.families.usb2.mock:MOCK",
    host="inteco_abs.boards.families.usb2.host:HOST",
    protocols=tuple(map(_protocol, LOGICS.values())),
    traffic=UsbTraffic(
        ENDPOINT_OUT,
        ENDPOINT_IN,
        lambda endpoint, data: endpoint in {ENDPOINT_OUT, ENDPOINT_IN} and len(data) == FRAME_BYTES,
        programming=(ENDPOINT_JTAG_OUT, ENDPOINT_JTAG_IN),
    ),
    bridge_facts=_bridge_facts,
    identify_led=_identify_led,
)
