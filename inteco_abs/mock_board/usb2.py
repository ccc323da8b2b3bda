"""The mock board as an RT-DAC/USB2: bulk transfers of real frames in, real frames out."""

from __future__ import annotations

from typing import Final

from firmware_protocol import ProtocolError
from firmware_protocol.rtdac_usb2 import FRAME_BYTES, LOGIC_VERSION, PWM_CHANNELS, READ, READ_REQUEST, SEND
from inteco_abs.mock_board.device import Device

APPLICATION_NAME: Final = "ABSSIM"
_SYNTHESIS_DATE: Final = "20260101"
_HEADER: Final[dict[str, int | str]] = {
    "logic_version": LOGIC_VERSION,
    "application_name": APPLICATION_NAME,
    "synthesis_date": _SYNTHESIS_DATE,
    "pwm_channels": PWM_CHANNELS,
    "encoder_channels": 8,
    "encoder_index_channels": 8,
    "timer_counter_channels": 2,
    "frequency_meter_channels": 8,
    "chronometer_channels": 8,
}
_WIDTH_MASK: Final = 0x0FFF
_NUMBER_MASK: Final = 0x7FFF
_ECHOED: Final = tuple(name for name in SEND.fields if name in READ.fields)


class Usb2Face:
    """Bulk endpoints of the board: what the host writes and reads, byte for byte.

    Malformed writes are dropped, as nothing is known of any complaint of the real board; `rejected` counts them.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.rejected = 0
        cable = device.cable
        # what changes with every frame: the two widths that move the rig, and the word that hosts number frames with
        self._hot = (f"pwm{cable.drive_pwm}_width", f"pwm{cable.brake_pwm}_width", f"pwm{PWM_CHANNELS - 1}_prescaler")
        self._echoed = [READ.place(name) for name in self._hot]
        # of a prescaler, the first word: the same one in both directions
        self._written = [SEND.place(name) for name in self._hot[:2]] + self._echoed[2:]
        self._road = READ.place(f"encoder{cable.road_encoder}_count")
        self._wheel = READ.place(f"encoder{cable.wheel_encoder}_count")
        self._newest = b""  # last SEND frame, and the same with its widths blanked: what need not be decoded again
        self._settled = bytearray()
        self._number_top = 0
        self._answer = bytearray(READ.encode(_HEADER))
        self._timers: list[int] = []
        self._waiting: list[bytes] = []

    def bulk_out(self, data: bytes | bytearray) -> None:
        """What the host writes to endpoint 0x02."""
        if len(data) == FRAME_BYTES:
            self._send(data)
        elif data == READ_REQUEST:
            self._waiting.append(self._read())
        else:
            self.rejected += 1

    def bulk_in(self, length: int) -> bytes:
        """What the host gets from endpoint 0x84: the oldest waiting answer, empty if there is none."""
        return self._waiting.pop(0)[:length] if self._waiting else b""

    def _send(self, data: bytes | bytearray) -> None:
        if data == self._newest:
            self.device.observe()
            return
        blank = bytearray(data)
        drive, brake, number = (codec.unpack_from(data, offset)[0] for offset, codec in self._written)
        for offset, codec in self._written:
            codec.pack_into(blank, offset, 0)
        if blank == self._settled and drive <= _WIDTH_MASK and brake <= _WIDTH_MASK and number <= _NUMBER_MASK:
            self.device.write_widths(drive, brake)
        else:
            try:
                settings = SEND.decode(data)
            except ProtocolError:
                self.rejected += 1
                return
            self.device.write({name: value for name, value in settings.items() if isinstance(value, int)})
            self._settle(blank)
        self._newest = bytes(data)
        echo = (drive & _WIDTH_MASK, brake & _WIDTH_MASK, number | self._number_top)
        for (offset, codec), value in zip(self._echoed, echo, strict=True):
            codec.pack_into(self._answer, offset, value)

    def _read(self) -> bytes:
        road, wheel = self.device.counts()
        self._road.codec.pack_into(self._answer, self._road.offset, road)
        self._wheel.codec.pack_into(self._answer, self._wheel.offset, wheel)
        for i in self._timers:
            place = READ.place(f"timer{i}_value")
            place.codec.pack_into(self._answer, place.offset, self.device.timer(i))
        return bytes(self._answer)

    def _settle(self, blank: bytearray) -> None:
        """Make the answer anew, with the settings echoed in their read encoding."""
        device = self.device
        self._settled = blank
        self._number_top = device.settings[self._hot[2]] & ~_NUMBER_MASK  # sent in the word after it
        echo = {name: device.settings[name] for name in _ECHOED}
        self._answer = bytearray(READ.encode({**_HEADER, **echo, "pin_input": device.pins()}))
        self._timers = [i for i in range(2) if device.timer_runs(i)]
