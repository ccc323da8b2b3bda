"""The mock board as an RT-DAC/USB2: answers the frames of every known logic."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Final

from firmware_protocol import Logic, ProtocolError
from firmware_protocol.fields import first_word, sent_back
from firmware_protocol.rtdac_usb2 import FRAME_BYTES, LOGIC_VERSION, LOGICS, READ, READ_REQUEST, SEND
from inteco_abs.config import MOCK_NAMES
from inteco_abs.mock_board import (
    AnswerConstants,
    AnswerState,
    Connected,
    Device,
    MockFamily,
    always_connected,
    reported_frames,
    require_terminals,
)
from inteco_abs.mock_board.usbip.usb_board import UsbBoard
from inteco_abs.mock_board.usbip.usb_descriptors import UsbIdentity

APPLICATION_NAME: Final = MOCK_NAMES[0]
_SYNTHESIS_DATE: Final = "20260101"
_WIDTH_MASK: Final = 0x0FFF
_NUMBER_MASK: Final = 0x7FFF
_LATCH: Final = 2 * SEND.fields["pin_output"][1][0].word
"""First byte of the pins' latch, in both directions: 15 and 11 bits sent, 16 and 10 bits read."""
_LOW_LATCH, _HIGH_LATCH = 0x7FFF, 0x07FF
_LEVELS: Final = 2 * READ.fields["pin_input"][1][0].word
_WORD: Final = struct.Struct("<H")


def _header(logic: Logic) -> dict[str, int | str]:
    """Return the header: the generic logic's, with this logic's numbers of PWM and encoder channels."""
    return {
        "logic_version": LOGIC_VERSION,
        "application_name": APPLICATION_NAME,
        "synthesis_date": _SYNTHESIS_DATE,
        "pwm_channels": logic.pwm_channels,
        "encoder_channels": logic.encoder_channels,
        "encoder_index_channels": logic.encoder_channels,
        "timer_counter_channels": 2,
        "frequency_meter_channels": 8,
        "chronometer_channels": 8,
    }


class Usb2FrontEnd:
    """The board's bulk endpoints, with the frames of the device's logic.

    Drops malformed writes, as no error reply of the real board is known; `rejected` counts them. `image` is the READ
    frame at power-up: its settings, and the words that no table names, which the mock echoes like settings. Without it
    all are zero. Raises ProtocolError for a damaged image.
    """

    def __init__(self, device: Device, image: bytes = b"") -> None:
        self.device = device
        self.rejected = 0
        logic = LOGICS[device.frame_map]
        self._tables = read, send = logic.read, logic.send
        self._header = _header(logic)
        self._echoed = tuple(name for name in send.fields if name in read.fields)
        # bits without a name, by word, which is the same both ways
        self._unnamed = [~(a | b) & 0xFFFF for a, b in zip(read.named_bits, send.named_bits, strict=True)]
        self._numbering = f"pwm{logic.pwm_channels - 1}_prescaler"
        cable = device.cable
        require_terminals(cable, read)
        # these change with every frame: the rig's two widths, and the word with which hosts number frames
        drive, brake, number = f"pwm{cable.drive_pwm}_width", f"pwm{cable.brake_pwm}_width", self._numbering
        self._drive, self._brake = send.place(drive).offset, send.place(brake).offset
        self._drive_echo, self._brake_echo = read.place(drive).offset, read.place(brake).offset
        self._number = read.place(number).offset  # of a prescaler, the lower 15 bits: the same word both ways
        self._road = read.place(f"encoder{cable.road_encoder}_count")
        self._wheel = read.place(f"encoder{cable.wheel_encoder}_count")
        self._hot = (self._drive, self._brake, self._number, _LATCH, _LATCH + 2)
        self._newest = bytearray(FRAME_BYTES)  # last decoded frame; equal ones are not decoded again
        self._written = (0, 0, 0)  # the last frame's two widths and its latch, with bits that no table names
        self._number_top = 0
        self._answer = bytearray(read.encode(self._header))
        self._timers: list[int] = []
        self._waiting: list[bytes] = []
        if image:
            self._decode(sent_back(read, send, image))
            self._keep_unnamed(image)

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Receive a message of the host at endpoint 0x02."""
        if len(data) == FRAME_BYTES:
            self._send(data)
        elif data == READ_REQUEST:
            self._waiting.append(self._read())
        else:
            self.rejected += 1

    def bulk_in(self, length: int) -> bytes:
        """Return the oldest waiting answer at endpoint 0x84; empty if there is none."""
        return self._waiting.pop(0)[:length] if self._waiting else b""

    def answer_parts(self) -> tuple[AnswerConstants, AnswerState] | None:
        """Return what `take_command` and `give_counts` work on while all other settings stay; None if they do not."""
        terminals = self.device.terminals()
        if terminals is None or self._timers or self._waiting:
            return None
        (read, send), cable = self._tables, self.device.cable
        drive, brake = f"pwm{cable.drive_pwm}_width", f"pwm{cable.brake_pwm}_width"
        (wheel_sign, wheel_offset), (road_sign, road_offset) = (
            counter.sign_and_offset for counter in (terminals.wheel, terminals.road)
        )
        k = AnswerConstants(
            terminals.drive_full or 1,
            terminals.brake_full or 1,
            terminals.drive_full > 0,
            terminals.brake_full > 0,
            wheel_sign,
            road_sign,
            wheel_offset,
            road_offset,
            self._number_top,
            send.bytes_of(drive),
            send.bytes_of(brake),
            first_word(send, self._numbering),
            read.bytes_of(drive),
            read.bytes_of(brake),
            first_word(read, self._numbering),
            read.bytes_of(f"encoder{cable.wheel_encoder}_count"),
            read.bytes_of(f"encoder{cable.road_encoder}_count"),
        )
        state = AnswerState(list(self._answer), *self.device.duties, terminals.time_ns, terminals.readings)
        return k, state

    def resume(self, s: AnswerState) -> None:
        """Go on after exchanges of `answer_parts`."""
        self._answer[:] = bytes(s.answer)
        echoed = self._drive_echo, self._brake_echo
        drive, brake = (_WORD.unpack_from(self._answer, place)[0] for place in echoed)
        self._written = drive, brake, self._written[2]
        self.device.settings[self._numbering] = _WORD.unpack_from(self._answer, self._number)[0]
        self.device.resume(s.time_ns, s.readings, (s.drive, s.brake), (drive, brake))

    def _send(self, data: bytes | bytearray) -> None:
        newest = self._newest
        for at in self._hot:
            newest[at : at + 2] = data[at : at + 2]
        word = _WORD.unpack_from
        drive, brake, number = word(data, self._drive)[0], word(data, self._brake)[0], word(data, self._number)[0]
        low, high = word(data, _LATCH)[0], word(data, _LATCH + 2)[0]
        hot = drive <= _WIDTH_MASK and brake <= _WIDTH_MASK and number <= _NUMBER_MASK
        hot = hot and low <= _LOW_LATCH and high <= _HIGH_LATCH
        if not (hot and data == newest):
            self._decode(data)
            return
        latch = low | high << _LOW_LATCH.bit_length()
        if (drive, brake, latch) != self._written:
            self._written = drive, brake, latch
            self.device.write_quickly(drive, brake, latch)
            _WORD.pack_into(self._answer, self._drive_echo, drive)
            _WORD.pack_into(self._answer, self._brake_echo, brake)
            self._answer[_LATCH : _LATCH + 4] = latch.to_bytes(4, "little")
        else:
            self.device.observe()
        self.device.settings[self._numbering] = number = number | self._number_top
        _WORD.pack_into(self._answer, self._number, number)

    def _decode(self, data: bytes | bytearray) -> None:
        """Apply a frame with new settings, and encode the answer that echoes them."""
        read, send = self._tables
        try:
            settings = send.decode(data)
        except ProtocolError:
            self.rejected += 1
            return
        device = self.device
        device.write({name: value for name, value in settings.items() if isinstance(value, int)})
        self._newest[:] = data
        self._number_top = device.settings[self._numbering] & ~_NUMBER_MASK  # sent in the word after it
        echo = {name: device.settings[name] for name in self._echoed}
        self._answer = bytearray(read.encode({**self._header, **echo, "pin_input": device.pins()}))
        self._keep_unnamed(data)
        self._timers = [i for i in range(2) if f"timer{i}_value" in read.fields and device.timer_runs(i)]
        drive, brake, low, high = (_WORD.unpack_from(data, at)[0] for at in (*self._hot[:2], *self._hot[3:]))
        self._written = drive, brake, low | high << _LOW_LATCH.bit_length()

    def _keep_unnamed(self, frame: bytes | bytearray) -> None:
        """Echo the bits that no table names from a frame of either direction."""
        table = self._tables[0]
        shown = zip(table.words(self._answer), table.words(frame), self._unnamed, strict=True)
        self._answer = bytearray(table.pack([answer & ~mask | word & mask for answer, word, mask in shown]))

    def _read(self) -> bytes:
        road, wheel = self.device.counts()
        self._road.codec.pack_into(self._answer, self._road.offset, road)
        self._wheel.codec.pack_into(self._answer, self._wheel.offset, wheel)
        for i in self._timers:
            place = self._tables[0].place(f"timer{i}_value")
            place.codec.pack_into(self._answer, place.offset, self.device.timer(i))
        if self.device.cable.watchdog_contact_pin >= 0:
            self._answer[_LEVELS : _LEVELS + 4] = self.device.pins().to_bytes(4, "little")
        return bytes(self._answer)


def _pin_of_generic_logic(settings: Mapping[str, int], channel: int) -> bool:
    """Return whether a channel's PWM pin, its third (docs/facts/boards.md#generic-usb2-logic), is an output."""
    pin = 3 * channel + 2
    return bool(settings.get("pin_mode", 0) >> pin & 1 and not settings.get("pin_direction", 0) >> pin & 1)


def _pin_of_power_interface(settings: Mapping[str, int], channel: int) -> bool:
    """Return whether CN1 pin 19 (PWM 0) or 23 (PWM 1) is an output (S5)."""
    return not settings.get("pin_direction", 0) >> (4 * channel + 19) & 1


_CONNECTED: Final[dict[str, Connected]] = {
    "generic": _pin_of_generic_logic,
    "servo": _pin_of_power_interface,
    "tras": always_connected,
    "rpend": always_connected,
    "abs": _pin_of_power_interface,
}


MOCK: Final = MockFamily(
    front_end=Usb2FrontEnd,
    reported=reported_frames(Usb2FrontEnd),
    connected=lambda wiring: _CONNECTED[wiring.frame_map],
    identity_offset=READ.place("logic_version").offset,
    usb_device=lambda front_end, identity, serial: UsbBoard(front_end, identity(UsbIdentity(serial=serial))),
)
