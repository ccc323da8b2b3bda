"""The mock board as an RT-DAC4/PCI with the ABS logic: 64 registers, most of them undocumented."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from firmware_protocol import ProtocolError, Register
from firmware_protocol import rtdac_pci as pci
from firmware_protocol.register_messages import decode_request, encode_answer
from firmware_protocol.registers import REGISTER_BITS
from firmware_protocol.rtdac_pci import PWM_WIDTH
from inteco_abs.boards.families.pci.board import registers_of
from inteco_abs.boards.frame_labels import BoardProtocol
from inteco_abs.mock_board import MAXIMUM_CELSIUS, MINIMUM_SUPPLY_V, Device, MockFamily

_WORD: Final = (1 << REGISTER_BITS) - 1
_COUNTS: Final = 0x04
_CHANNEL_COUNTS: Final = pci.ENCODER_CHANNELS << 4 | pci.PWM_CHANNELS  # which nibble is which is UNKNOWN
_WINDOW: Final = 200_000
"""5 ms: INFERRED, as whole counts in it are all velocities on the manual's screens (K3)."""
_RESISTOR_LOW, _RESISTOR_HIGH = 140, 150
"""1641 and 1758 rpm, on the manual's screens."""
_SUPPLY_SCALE_V: Final = 92_000
"""Product of the supply in volts and its register's value."""
_PULSE: Final = 1000
"""Length of the temperature sensor's low pulse, a guess: only the ratio of both pulses matters."""
_FIXED: Final = {
    pci.LOGIC.offset: pci.LOGIC_VERSION,
    _COUNTS: _CHANNEL_COUNTS,
    pci.VELOCITY_WINDOW.offset: _WINDOW,
    pci.MAXIMUM_ROAD_VELOCITY.offset: 200,  # 2344 rpm, on the manual's screens
    pci.RESISTOR1_LOW.offset: _RESISTOR_LOW,
    pci.RESISTOR1_HIGH.offset: _RESISTOR_HIGH,
    pci.RESISTOR2_LOW.offset: _RESISTOR_LOW,
    pci.RESISTOR2_HIGH.offset: _RESISTOR_HIGH,
    pci.MINIMUM_SUPPLY.offset: round(_SUPPLY_SCALE_V / MINIMUM_SUPPLY_V),
    pci.MAXIMUM_TEMPERATURE.offset: round(MAXIMUM_CELSIUS),
    pci.TEMPERATURE_LOW.offset: _PULSE,
}
_PWM: Final = {
    pci.PWM_MODE.offset: pci.PWM_MODE,
    pci.PWM_PRESCALER.offset: pci.PWM_PRESCALER,
    PWM_WIDTH.offset: PWM_WIDTH,
}
_INDEXES: Final = {pci.PWM_INDEX.offset: pci.PWM_INDEX, pci.ENCODER_INDEX.offset: pci.ENCODER_INDEX}


class PciFrontEnd:
    """The board's registers, accessed one by one or in messages that replace the bus.

    `reported` are values of constant registers by offset, from the report of a board. Undocumented offsets read 0.
    Writes to them, to registers that no source writes, and of a missing channel are dropped, as are malformed messages;
    `rejected` counts them. The alarm flags do not depend on supply and temperature, as their meaning is unknown (K1,
    K2).
    """

    def __init__(self, device: Device, reported: Mapping[int, int] = MappingProxyType({})) -> None:
        self.device = device
        self.rejected = 0
        self._fixed = {offset: reported.get(offset, value) for offset, value in _FIXED.items()}
        self._selected = dict.fromkeys(_INDEXES, 0)
        self._unobserved = False  # whether the observer has not been informed of a written width
        self._in_series = True
        self._waiting: list[bytes] = []
        self._moving: dict[int, Callable[[], int]] = {
            pci.ENCODER_COUNT.offset: self._count,
            pci.ROAD_VELOCITY.offset: lambda: _lines(device.plant.road_speed),
            pci.WHEEL_VELOCITY.offset: lambda: _lines(device.plant.wheel_speed),
            pci.RESISTOR1_IN_SERIES.offset: self._resistors,
            pci.SUPPLY.offset: self._supply,
            pci.TEMPERATURE_HIGH.offset: lambda: round(
                (235 - device.power_interface.temperature_celsius) / 400 * _PULSE
            ),
            pci.ALARM_BIT0.offset: lambda: device.power_interface.alarms,
        }

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Receive a message of the host: accesses in order, at one instant of the rig.

        A bus makes them within microseconds. In CPython the rig needs up to 0.2 ms for each advance while its wheels
        begin to turn, and six advances are more than a period.
        """
        try:
            number, steps = decode_request(data)
        except ProtocolError:
            self.rejected += 1
            return
        values = []
        with self.device.instant():
            for step in steps:
                if isinstance(step, int):
                    values.append(self.read(step))
                else:
                    self.write(*step)
        if values:
            self._waiting.append(encode_answer(number, values))

    def bulk_in(self, length: int) -> bytes:
        """Return the oldest waiting answer; empty if there is none."""
        return self._waiting.pop(0)[:length] if self._waiting else b""

    def read(self, offset: int) -> int:
        """Return the 32 bits at `offset`."""
        # one command writes two widths and reads the old ones: the observer is informed once
        if self._unobserved and offset not in _PWM:
            self._unobserved = False
            self.device.observe()
        if offset in self._fixed:
            return self._fixed[offset]
        if offset in self._moving:
            self.device.catch_up()
            return self._moving[offset]() & _WORD
        if offset in self._selected:
            return self._selected[offset]
        settings = self.device.settings
        if offset == pci.ENCODER_RESET.offset:
            return settings.get("encoder_reset", 0)
        return settings.get(self._name(_PWM[offset]), 0) if offset in _PWM else 0

    def write(self, offset: int, value: int) -> None:
        """Write `value` at `offset`; bits beyond the register's width are lost."""
        if offset in _INDEXES and value < _INDEXES[offset].channels:
            self._selected[offset] = value
        elif offset in _PWM:
            register = _PWM[offset]
            self._unobserved = self._unobserved or register is PWM_WIDTH
            self.device.apply({self._name(register): register.decode(value)})
        elif offset == pci.ENCODER_RESET.offset:
            self.device.apply({"encoder_reset": pci.ENCODER_RESET.decode(value)})
        else:
            self.rejected += 1

    def _name(self, register: Register) -> str:
        """Return the device's name for a setting of the selected PWM channel."""
        return register.name.replace("pwm", f"pwm{self._selected[pci.PWM_INDEX.offset]}")

    def _count(self) -> int:
        """Return the selected counter; the balance lever's is 0, as the simulated rig has no moving lever."""
        road, wheel = self.device.counts()
        cable = self.device.cable
        return {cable.road_encoder: road, cable.wheel_encoder: wheel}.get(self._selected[pci.ENCODER_INDEX.offset], 0)

    def _supply(self) -> int:
        volts = self.device.power_interface.supply_v
        return round(_SUPPLY_SCALE_V / volts) if volts > 0.0 else 0

    def _resistors(self) -> int:
        """Return the bits of both start-up resistors: in series until the road wheel is fast, and when it is slow."""
        velocity = _lines(self.device.plant.road_speed)
        self._in_series = velocity < (_RESISTOR_HIGH if self._in_series else _RESISTOR_LOW)
        return pci.RESISTOR1_IN_SERIES.mask | pci.RESISTOR2_IN_SERIES.mask if self._in_series else 0


def _lines(speed_rad_s: float) -> int:
    """Return the value of a velocity register: encoder lines in one window."""
    return int(abs(speed_rad_s) / (2.0 * math.pi) * pci.ENCODER_LINES * _WINDOW / pci.VELOCITY_CLOCK_HZ)


def _reported(device: Device, _: BoardProtocol | None, image: bytes) -> PciFrontEnd:
    constant: dict[int, int] = {}
    settings: dict[str, int] = {}
    counts: dict[str, int] = {}
    for name, register, channel, bits in registers_of(image):
        if name.startswith("pwm") or name == "encoder_reset":
            settings[name] = register.decode(bits)
        elif name.endswith("_count"):
            counts[name] = register.decode(bits)
        elif channel is None:
            constant[register.offset] = bits
    device.write(settings)
    cable = device.cable
    device.begin_counts(counts[f"encoder{cable.road_encoder}_count"], counts[f"encoder{cable.wheel_encoder}_count"])
    return PciFrontEnd(device, constant)


MOCK: Final = MockFamily(front_end=PciFrontEnd, reported=_reported, has_alarms=True)
