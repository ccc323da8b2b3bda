"""The mock RT-DAC/USB2 as a USB device: the bridge's firmware between the bus and the FPGA's frames."""

from __future__ import annotations

import struct
from typing import Final

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, FRAME_BYTES
from firmware_protocol.rtdac_usb2_bridge import (
    DATE_BYTES,
    ENDPOINT_JTAG_IN,
    ENDPOINT_JTAG_OUT,
    REQUEST_DATE,
    REQUEST_DATE_ADDRESSES,
    REQUEST_LED_OFF,
    REQUEST_LED_ON,
)
from inteco_abs.mock_board.frontend import FrontEnd
from inteco_abs.mock_board.usbip.usb_descriptors import UsbIdentity
from inteco_abs.mock_board.usbip.usb_device import Handshake, SetupPacket, UsbAnswer, UsbDevice

_COMPILED_AT: Final = 0x1000
_RELEASED_AT: Final = 0x1040
_ADDRESSES: Final = struct.pack("<2xHH", _COMPILED_AT, _RELEASED_AT)
_DATES: Final = {_COMPILED_AT: "2026-01-01", _RELEASED_AT: "2026-01-02"}
_FROM_DEVICE: Final = 0xC0
"""Vendor request IN, recipient device: INFERRED, the defaults of the vendor's USB library."""
_TO_DEVICE: Final = 0x40
_MOST_UNREAD: Final = 8
"""Answers that wait for the host. A bridge of this family has room for two at most (INFERRED)."""


class UsbBoard(UsbDevice):
    """A board whose FPGA is `front_end`.

    The real board's reaction to a message that is not a frame, to a full queue and to a date's wrong address is
    UNKNOWN. Here the front end drops and counts the message, a full queue loses the answer, and a wrong address gives
    STALL.
    """

    def __init__(self, front_end: FrontEnd, identity: UsbIdentity | None = None) -> None:
        super().__init__(identity or UsbIdentity())
        self.front_end = front_end
        self.led = False
        self.jtag_transfers = 0
        """Transfers to the endpoints that program the FPGA, each a mistake of the host."""
        self.lost_answers = 0
        """Answers lost in a full queue."""

    def catch_up(self) -> None:
        """Advance the rig."""
        self.front_end.device.catch_up()

    def packet_in(self, endpoint: int) -> UsbAnswer:
        """Return a packet from the FPGA; STALL for JTAG."""
        return self._stall(endpoint) if endpoint == ENDPOINT_JTAG_IN else super().packet_in(endpoint)

    def packet_out(self, endpoint: int, packet: bytes) -> Handshake:
        """Receive a packet for the FPGA; STALL for JTAG."""
        return self._stall(endpoint) if endpoint == ENDPOINT_JTAG_OUT else super().packet_out(endpoint, packet)

    def _stall(self, endpoint: int) -> Handshake:
        self.jtag_transfers += 1
        self._halted.add(endpoint)
        return Handshake.STALL

    def _receive(self, message: bytes) -> None:
        self.front_end.bulk_out(message)
        room = _MOST_UNREAD * (FRAME_BYTES // self.identity.speed.packet_bytes + 1)
        while answer := self.front_end.bulk_in(FRAME_BYTES):
            if self._waiting(ENDPOINT_IN) >= room:
                self.lost_answers += 1
            else:
                self._send(ENDPOINT_IN, answer)

    def _vendor(self, setup: SetupPacket, data: bytes) -> UsbAnswer:
        request = setup.request_type, setup.request
        if request == (_FROM_DEVICE, REQUEST_DATE_ADDRESSES) and setup.value == 0:
            return _ADDRESSES
        if request == (_FROM_DEVICE, REQUEST_DATE) and setup.value in _DATES:
            return _DATES[setup.value].encode("utf-16-le").ljust(DATE_BYTES, b"\0")
        if request in {(_TO_DEVICE, REQUEST_LED_OFF), (_TO_DEVICE, REQUEST_LED_ON)} and not (setup.value or data):
            self.led = setup.request == REQUEST_LED_ON
            return Handshake.ACK
        return Handshake.STALL  # also 0xA0, which loads firmware into a real bridge
