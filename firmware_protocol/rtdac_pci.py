"""RT-DAC4/PCI: 64 registers of 32 bits; the ABS logic 0x050F and the generic registers of the vendor's driver.

All accesses are 32 bits wide, at a byte offset from the base of an I/O range of 256 bytes. The map belongs to the
logic in the FPGA, not to the board: other rigs' logics have their PWM elsewhere, and the ABS logic has thresholds
where the generic map has its A/D converter. Check the version before you write anything.

All facts come from the vendor's ABS software for this board with its manuals (docs/facts/sources.md#s3). K1 and K2 are
contradictions about the alarm flags (docs/facts/boards.md#contradictions).
"""

from __future__ import annotations

from functools import partial
from typing import Final

from firmware_protocol.fields import ProtocolError, Status, ValueKind
from firmware_protocol.registers import REGISTER_BYTES, Access, Conversion, Register, RegisterMap

VENDOR_ID: Final = 0x10B5
DEVICE_ID: Final = 0x2497
"""Vendor and device id are those of the PLX bridge on the board, not of the board's maker (S3)."""
BAR_INDEX: Final = 2
"""Base address register of the I/O range: the dword at 0x18 of the configuration space (S3)."""
BAR_BYTES: Final = 256
REGISTER_COUNT: Final = BAR_BYTES // REGISTER_BYTES

LOGIC_VERSION: Final = 0x050F
"""The ABS logic."""
VELOCITY_CLOCK_HZ: Final = 40_000_000
"""Clock of the velocity window. Timers of other logics run at other clocks."""
ENCODER_LINES: Final = 1024
"""Per turn; the velocity registers count lines, the encoder counters quarter lines."""
PWM_CHANNELS: Final = 2
ENCODER_CHANNELS: Final = 3
"""The third is the balance lever's, which not every rig has."""


def supply_volts(count: int) -> float:
    """Convert a register value to the motor supply in volts, 0 for the count 0."""
    return 92_000 / count if count else 0.0


def velocity_rpm(count: int, window: int) -> float:
    """Convert `count` encoder lines in `window` ticks of 1/40 MHz to revolutions per minute.

    Raises ProtocolError for the window 0: it gives no velocity, and a zero would mean that the wheel stands.
    """
    if not window:
        raise ProtocolError("velocity_window = 0: a velocity needs a window of at least one tick")
    return count * 60 * (VELOCITY_CLOCK_HZ / window) / ENCODER_LINES


def temperature_celsius(high: int, low: int) -> float:
    """Convert the lengths of the sensor's high and low pulses to degrees Celsius, 0 if either is 0."""
    return 235 - 400 * high / low if high and low else 0.0


def window_us(count: int) -> float:
    """Convert the velocity window from ticks of 1/40 MHz to microseconds."""
    return count / 40


def _velocity(name: str) -> Conversion:
    formula = "count * 60 * (40e6 / velocity_window) / 1024"
    return Conversion("rpm", formula, velocity_rpm, (name, "velocity_window"))


def _supply(name: str) -> Conversion:
    return Conversion("V", "92000 / count; 0 if 0", supply_volts, (name,))


_RAW: Final = "raw"
_BITMAP: Final = "bit mask"
_TICKS: Final = "1/40 MHz"
_LINES: Final = "lines per window"
_BOTH: Final = Access.READ_WRITE
_UNKNOWN: Final = Status.UNKNOWN
_register: Final = partial(Register, source="S3")
_writable: Final = partial(_register, access=_BOTH)

LOGIC: Final = _register("logic_version", 0x00, "version of the FPGA logic; shown in hex", _RAW, width=16)
_KINDS: Final = "numbers of PWM and of encoder channels, four bits each; which are which is unknown"
_COUNTS: Final = (
    _register("counter_channels", 0x04, "number of counter channels", "1", low=12, width=4),
    _register("timer_channels", 0x04, "number of timer channels", "1", low=8, width=4),
    _register("pwm_encoder_channels", 0x04, _KINDS, _RAW, width=8, status=_UNKNOWN),
)

_DIVIDER: Final = (
    "clock divider minus one; frequency = 40 MHz / ((prescaler + 1) * 255 or 4095). The vendor's class stops at 63"
)
PWM_INDEX: Final = _writable(
    "pwm_index", 0x60, "PWM channel that mode, prescaler and width belong to", "1", channels=PWM_CHANNELS
)
PWM_MODE: Final = _writable("pwm_mode", 0x64, "0 = 8-bit, 1 = 12-bit", "1", width=1, index=PWM_INDEX)
PWM_PRESCALER: Final = _writable("pwm_prescaler", 0x68, _DIVIDER, "1", width=16, index=PWM_INDEX)
PWM_WIDTH: Final = _writable(
    "pwm_width", 0x6C, "part of the period at logic 1, of 255 or 4095", "1", width=12, index=PWM_INDEX
)
ENCODER_INDEX: Final = _writable(
    "encoder_index", 0x80, "encoder that the counter belongs to", "1", channels=ENCODER_CHANNELS
)
ENCODER_RESET: Final = _writable(
    "encoder_reset", 0x84, "counter i is held at 0 while bit i is 1; not indexed", _BITMAP, width=4
)
_COUNTER: Final = "32-bit quadrature counter (x4), two's complement, wraps"
ENCODER_COUNT: Final = _register("encoder_count", 0x88, _COUNTER, "counts", kind=ValueKind.SIGNED, index=ENCODER_INDEX)

SUPPLY: Final = _register("supply", 0x38, "motor supply, measured", _RAW, conversion=_supply("supply"))
_WINDOW: Final = "window in which the velocities are counted (5 or 50 ms is inferred)"
_MICROSECONDS: Final = Conversion("us", "count / 40", window_us, ("velocity_window",))
VELOCITY_WINDOW: Final = _register("velocity_window", 0x50, _WINDOW, _TICKS, conversion=_MICROSECONDS)
ROAD_VELOCITY: Final = _register(
    "road_velocity", 0x54, "lower wheel", _LINES, width=16, conversion=_velocity("road_velocity")
)
WHEEL_VELOCITY: Final = _register(
    "wheel_velocity", 0x58, "upper wheel", _LINES, width=16, conversion=_velocity("wheel_velocity")
)


def _threshold(name: str, offset: int, meaning: str, unit: str, conversion: Conversion | None) -> Register:
    note = f"{meaning}; no source writes it, whether it can be written is unknown"
    return _register(name, offset, note, unit, conversion=conversion)


def _velocity_limit(name: str, offset: int, meaning: str) -> Register:
    return _threshold(name, offset, meaning, _LINES, _velocity(name))


MAXIMUM_ROAD_VELOCITY: Final = _velocity_limit("maximum_road_velocity", 0x5C, "limit of the lower wheel's velocity")
RESISTOR1_IN_SERIES: Final = _register("resistor1_in_series", 0x90, "start-up resistor 1: 1 = in series", "1", width=1)
RESISTOR2_IN_SERIES: Final = _register(
    "resistor2_in_series", 0x90, "start-up resistor 2: 1 = in series", "1", low=1, width=1
)
RESISTOR1_LOW: Final = _velocity_limit("resistor1_low", 0x94, "low velocity threshold of start-up resistor 1")
RESISTOR1_HIGH: Final = _velocity_limit("resistor1_high", 0x98, "high velocity threshold of start-up resistor 1")
RESISTOR2_LOW: Final = _velocity_limit("resistor2_low", 0x9C, "low velocity threshold of start-up resistor 2")
RESISTOR2_HIGH: Final = _velocity_limit("resistor2_high", 0xA0, "high velocity threshold of start-up resistor 2")
MINIMUM_SUPPLY: Final = _threshold("minimum_supply", 0xA4, "limit of the motor supply", _RAW, _supply("minimum_supply"))
MAXIMUM_TEMPERATURE: Final = _threshold("maximum_temperature", 0xA8, "limit of the temperature", "degC", None)


def _alarm(name: str, bit: int, meaning: str) -> Register:
    note = f"{meaning}; advisory only: whether 1 means tripped is unknown (K2)"
    return _register(name, 0xAC, note, "1", low=bit, width=1, status=_UNKNOWN)


ALARM_BIT0: Final = _alarm("alarm_bit0", 0, "temperature or lower wheel's speed, the sources disagree (K1)")
ALARM_SUPPLY: Final = _alarm("alarm_supply", 1, "motor supply, the sources agree")
ALARM_BIT2: Final = _alarm("alarm_bit2", 2, "lower wheel's speed or temperature, the sources disagree (K1)")

_TEMPERATURE: Final = Conversion(
    "degC",
    "235 - 400 * temperature_high / temperature_low; 0 if either is 0",
    temperature_celsius,
    ("temperature_high", "temperature_low"),
)
TEMPERATURE_HIGH: Final = _register(
    "temperature_high", 0xB4, "length of the temperature sensor's high pulse", _RAW, conversion=_TEMPERATURE
)
TEMPERATURE_LOW: Final = _register(
    "temperature_low", 0xB8, "length of the temperature sensor's low pulse", _RAW, conversion=_TEMPERATURE
)

ABS: Final = RegisterMap(
    f"RT-DAC4/PCI, ABS logic 0x{LOGIC_VERSION:04X}",
    (
        LOGIC, *_COUNTS, SUPPLY, VELOCITY_WINDOW, ROAD_VELOCITY, WHEEL_VELOCITY, MAXIMUM_ROAD_VELOCITY, PWM_INDEX,
        PWM_MODE, PWM_PRESCALER, PWM_WIDTH, ENCODER_INDEX, ENCODER_RESET, ENCODER_COUNT, RESISTOR1_IN_SERIES,
        RESISTOR2_IN_SERIES, RESISTOR1_LOW, RESISTOR1_HIGH, RESISTOR2_LOW, RESISTOR2_HIGH, MINIMUM_SUPPLY,
        MAXIMUM_TEMPERATURE, ALARM_BIT0, ALARM_SUPPLY, ALARM_BIT2, TEMPERATURE_HIGH, TEMPERATURE_LOW,
    ),
    size=BAR_BYTES,
)  # fmt: skip
"""Every register that the ABS logic is known to have. The driver and the mock use this map only."""

_generic: Final = partial(_writable, unit=_RAW)
_only_read: Final = partial(_register, unit=_RAW)
_index: Final = partial(_writable, unit="1", channels=15)
_INFERRED: Final = Status.INFERRED
_COUNTER_INDEX: Final = _index("counter_index", 0x20, "counter that the value belongs to, below counter_channels")
_TIMER_INDEX: Final = _index("timer_index", 0x2C, "timer that the value belongs to, below timer_channels")
_INPUTS: Final = "digital pins 0-15, direction; which value is input is unknown"
AD_MUX: Final = _generic("ad_mux", 0xA0, "A/D channel in bits 0-3, gain code in bits 4-6", width=7)
AD_CONTROL: Final = _generic("ad_control", 0xA4, "A/D lines CONVST, RD, CS; on read, bit 0 = 0 when converted")
AD_RESULT: Final = _only_read(
    "ad_result", 0xA8, "A/D result; that it is two's complement is inferred", width=12, status=_INFERRED
)

GENERIC: Final = RegisterMap(
    "RT-DAC4/PCI, generic registers",
    (
        _COUNTER_INDEX,
        _generic("counter_reset", 0x24, "counter reset; whether indexed or one bit each is unknown", status=_INFERRED),
        _only_read("counter_value", 0x28, "counter", width=16, index=_COUNTER_INDEX),
        _TIMER_INDEX,
        _generic("timer_reset", 0x30, "timer reset; whether indexed or one bit each is unknown", status=_INFERRED),
        _only_read("timer_value", 0x34, "timer", index=_TIMER_INDEX),
        _generic("pin_direction_low", 0x40, _INPUTS, width=16, status=_INFERRED),
        _generic("pin_direction_high", 0x44, "digital pins from 16, direction; likewise", width=16, status=_INFERRED),
        _generic("pin_value_low", 0x48, "digital pins 0-15, levels", width=16),
        _generic("pin_value_high", 0x4C, "digital pins from 16, levels", width=16),
        AD_MUX,
        AD_CONTROL,
        AD_RESULT,
        _generic("da_control", 0xC0, "D/A lines LDAC, R/W, CS; channel from bit 3"),
        _generic("da_value", 0xC4, "D/A value", width=12),
    ),
    size=BAR_BYTES,
)
"""Registers that the vendor's driver also names, without proof that the ABS logic has them. For reference only: never
access them."""

COLLISIONS: Final = tuple(
    offset for offset in range(0, BAR_BYTES, REGISTER_BYTES) if ABS.at(offset) and GENERIC.at(offset)
)
"""Offsets at which the two maps differ: a driver for one disturbs the other."""
