"""The mock board as an RT-DAC/USB of the first generation: frames of logics 0x0111 and 0x0112, or a byte stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from firmware_protocol import ProtocolError
from firmware_protocol.fields import sent_back
from firmware_protocol.rtdac_usb import DUMMY, FRAME_BYTES, HEADER_BYTES, READ_REQUEST, logic_of
from inteco_abs.config import MOCK_NAMES
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.mock_board import Device, FrontEnd, MockFamily, reported_frames, require_terminals
from inteco_abs.mock_board.usbip.ftdi import FtdiBoard, ftdi_identity

APPLICATION_NAME: Final = MOCK_NAMES[1]
_COMMAND_BIT: Final = 0x80
_ALONE: Final = DUMMY + READ_REQUEST
"""Command bytes without data."""


class UsbFrontEnd:
    """The board's frames, as whole messages: DUMMY, SEND with its data, READ request and answer.

    An answer has the present counters, timers and pins, and echoes the settings of the last good SEND frame, including
    bits that no table names. `image` is the READ frame at power-up; without it all settings are zero. Raises
    ConfigError for a device whose logic has no tables.
    """

    def __init__(self, device: Device, image: bytes = b"") -> None:
        self.device = device
        self.rejected = 0
        try:
            logic = logic_of(device.logic_version)
        except ProtocolError as error:
            raise ConfigError([ConfigIssue("board.logic_version", str(error))]) from error
        self._read_table, self._send_table = logic.read, logic.send
        self._echoed = tuple(name for name in logic.send.fields if name in logic.read.fields)
        cable = device.cable
        require_terminals(cable, logic.read)
        self._road = logic.read.place(f"encoder{cable.road_encoder}_count")
        self._wheel = logic.read.place(f"encoder{cable.wheel_encoder}_count")
        self._timers = tuple(
            (i, logic.read.place(f"timer{i}_value")) for i in range(2) if f"timer{i}_value" in logic.read.fields
        )
        self._answer = bytearray(logic.read.encode({"application_name": APPLICATION_NAME}))
        self._pins = logic.read.place("pin_input")
        self._waiting: list[bytes] = []
        # data byte n is byte n of a READ frame, and byte n + 1 of a SEND frame, which has none for the last
        named = zip(logic.read.named_bits, logic.send.named_bits[1:], strict=False)
        self._unnamed = [~(mine | theirs) & 0xFF for mine, theirs in named]
        if image:
            self._send(sent_back(logic.read, logic.send, image))
            self._keep_unnamed(image)

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Receive a message from the host; rejects 0x83 (send and read), which no known program uses."""
        if len(data) == FRAME_BYTES:
            self._send(data)
        elif data == READ_REQUEST:
            self._waiting.append(self._read())
        elif data != DUMMY:
            self.rejected += 1

    def bulk_in(self, length: int) -> bytes:
        """Return the oldest waiting answer; empty if there is none."""
        return self._waiting.pop(0)[:length] if self._waiting else b""

    def _send(self, data: bytes | bytearray) -> None:
        try:
            settings = self._send_table.decode(data)
        except ProtocolError:
            self.rejected += 1
            return
        device = self.device
        device.write({name: value for name, value in settings.items() if isinstance(value, int)})
        echo = {name: device.settings[name] for name in self._echoed}
        shown: dict[str, int | str] = {"application_name": APPLICATION_NAME, **echo}
        self._answer[:] = self._read_table.encode(shown)
        self._keep_unnamed(data[1:])

    def _keep_unnamed(self, data: bytes | bytearray) -> None:
        """Echo the bits that no table names from these data bytes."""
        for at, mask in enumerate(self._unnamed):
            self._answer[at] = self._answer[at] & ~mask | data[at] & mask

    def _read(self) -> bytes:
        road, wheel = self.device.counts()
        self._road.codec.pack_into(self._answer, self._road.offset, road)
        self._wheel.codec.pack_into(self._answer, self._wheel.offset, wheel)
        for i, place in self._timers:
            place.codec.pack_into(self._answer, place.offset, self.device.timer(i))
        self._pins.codec.pack_into(self._answer, self._pins.offset, self.device.pins())
        return bytes(self._answer)


class ByteStream:
    """The board behind a FIFO: a byte stream in which bit 7 marks the first byte of a message.

    A message is complete after its command byte (DUMMY, READ) or after a frame's length; a command byte inside a frame
    ends it early, and the front end drops the fragment.
    """

    def __init__(self, front_end: FrontEnd) -> None:
        self.front_end = front_end
        self._arriving = bytearray()

    def feed(self, data: bytes | bytearray) -> bytes:
        """Receive bytes from the host; return the board's answer."""
        for byte in data:
            if byte & _COMMAND_BIT:
                self._deliver()
            self._arriving.append(byte)
            if byte in _ALONE or len(self._arriving) == FRAME_BYTES:
                self._deliver()
        return b"".join(iter(lambda: self.front_end.bulk_in(FRAME_BYTES), b""))

    def _deliver(self) -> None:
        """Pass on the bytes of a message, complete or not."""
        if self._arriving:
            self.front_end.bulk_out(bytes(self._arriving))
            self._arriving.clear()


def _function_bit(settings: Mapping[str, int], channel: int) -> bool:
    """Return the channel's function bit (INFERRED); whether the pin's direction matters is unknown."""
    return bool(settings.get("pin_mode", 0) >> channel & 1)


MOCK: Final = MockFamily(
    front_end=UsbFrontEnd,
    reported=reported_frames(UsbFrontEnd),
    connected=lambda _wiring: _function_bit,
    identity_offset=HEADER_BYTES - 1,
    usb_device=lambda front_end, identity, serial: FtdiBoard(ByteStream(front_end), identity(ftdi_identity(serial))),
    stream=ByteStream,
)
