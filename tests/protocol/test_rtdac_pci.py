import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import Access, ProtocolError, Status, ValueKind, Write, rtdac_pci
from firmware_protocol.rtdac_pci import (
    ABS,
    COLLISIONS,
    GENERIC,
    supply_volts,
    temperature_celsius,
    velocity_rpm,
    window_us,
)

# name: offset, lowest bit, width, whether the host writes it, index
MAP = {
    "logic_version": (0x00, 0, 16, False, None),
    "pwm_encoder_channels": (0x04, 0, 8, False, None),
    "timer_channels": (0x04, 8, 4, False, None),
    "counter_channels": (0x04, 12, 4, False, None),
    "supply": (56, 0, 32, False, None),
    "velocity_window": (80, 0, 32, False, None),
    "road_velocity": (84, 0, 16, False, None),
    "wheel_velocity": (88, 0, 16, False, None),
    "maximum_road_velocity": (92, 0, 32, False, None),
    "pwm_index": (0x60, 0, 32, True, None),
    "pwm_mode": (0x64, 0, 1, True, "pwm_index"),
    "pwm_prescaler": (0x68, 0, 16, True, "pwm_index"),
    "pwm_width": (0x6C, 0, 12, True, "pwm_index"),
    "encoder_index": (0x80, 0, 32, True, None),
    "encoder_reset": (0x84, 0, 4, True, None),
    "encoder_count": (0x88, 0, 32, False, "encoder_index"),
    "resistor1_in_series": (144, 0, 1, False, None),
    "resistor2_in_series": (144, 1, 1, False, None),
    "resistor1_low": (148, 0, 32, False, None),
    "resistor1_high": (152, 0, 32, False, None),
    "resistor2_low": (156, 0, 32, False, None),
    "resistor2_high": (160, 0, 32, False, None),
    "minimum_supply": (164, 0, 32, False, None),
    "maximum_temperature": (168, 0, 32, False, None),
    "alarm_bit0": (172, 0, 1, False, None),
    "alarm_supply": (172, 1, 1, False, None),
    "alarm_bit2": (172, 2, 1, False, None),
    "temperature_high": (180, 0, 32, False, None),
    "temperature_low": (184, 0, 32, False, None),
}

GENERIC_MAP = {
    "counter_index": (0x20, 32, True, None),
    "counter_reset": (0x24, 32, True, None),
    "counter_value": (0x28, 16, False, "counter_index"),
    "timer_index": (0x2C, 32, True, None),
    "timer_reset": (0x30, 32, True, None),
    "timer_value": (0x34, 32, False, "timer_index"),
    "pin_direction_low": (0x40, 16, True, None),
    "pin_direction_high": (0x44, 16, True, None),
    "pin_value_low": (0x48, 16, True, None),
    "pin_value_high": (0x4C, 16, True, None),
    "ad_mux": (0xA0, 7, True, None),
    "ad_control": (0xA4, 32, True, None),
    "ad_result": (0xA8, 12, False, None),
    "da_control": (0xC0, 32, True, None),
    "da_value": (0xC4, 12, True, None),
}


def shape(register):
    index = register.index.name if register.index else None
    return register.offset, register.low, register.width, register.access is Access.READ_WRITE, index


def test_the_board_is_found_by_its_bridge_and_has_64_registers():
    assert f"{rtdac_pci.VENDOR_ID:04x}:{rtdac_pci.DEVICE_ID:04x}" == "10b5:2497"
    assert (rtdac_pci.BAR_INDEX, rtdac_pci.BAR_BYTES, rtdac_pci.REGISTER_COUNT) == (2, 256, 64)
    assert rtdac_pci.LOGIC_VERSION == 0x050F


def test_abs_map():
    assert {name: shape(register) for name, register in ABS.registers.items()} == MAP


def test_generic_map():
    expected = {name: (offset, 0, *rest) for name, (offset, *rest) in GENERIC_MAP.items()}
    assert {name: shape(register) for name, register in GENERIC.registers.items()} == expected


def test_the_constants_are_the_registers_of_the_map():
    constants = {value.name for value in vars(rtdac_pci).values() if isinstance(value, rtdac_pci.Register)}
    assert set(MAP) - constants <= {"pwm_encoder_channels", "timer_channels", "counter_channels"}
    assert all(ABS.find(name) is getattr(rtdac_pci, name.upper()) for name in ("pwm_width", "encoder_count", "supply"))


def test_only_the_encoder_count_is_signed():
    signed = [register.name for register in ABS.registers.values() if register.kind is ValueKind.SIGNED]
    assert signed == ["encoder_count"]


def test_everything_else_in_the_range_is_nothing_to_the_abs_map():
    known = {offset for offset, *_ in MAP.values()}
    assert {offset for offset in range(256) if ABS.at(offset)} == known


@pytest.mark.parametrize(("channel", "width"), [(0, 0), (0, 4095), (1, 128)])
def test_a_pwm_width_is_written_behind_its_channel(channel, width):
    assert ABS.write(rtdac_pci.PWM_WIDTH, width, channel=channel) == (Write(0x60, channel), Write(0x6C, width))


def test_a_pwm_is_set_up_one_pair_after_the_other():
    writes = [
        *ABS.write(rtdac_pci.PWM_MODE, 1, channel=1),
        *ABS.write(rtdac_pci.PWM_PRESCALER, 65535, channel=1),
    ]
    assert writes == [(0x60, 1), (0x64, 1), (0x60, 1), (0x68, 65535)]


def test_all_encoders_are_released_in_one_write():
    assert ABS.write(rtdac_pci.ENCODER_RESET, 0) == (Write(0x84, 0),)


@pytest.mark.parametrize("channel", range(3))
def test_an_encoder_is_read_behind_its_channel(channel):
    assert ABS.select(rtdac_pci.ENCODER_COUNT, channel) == (Write(0x80, channel),)


@pytest.mark.parametrize(
    ("register", "channel", "limits"),
    [("pwm_width", 2, "0..1"), ("encoder_count", 3, "0..2"), ("pwm_mode", None, "0..1")],
)
def test_a_channel_that_the_rig_has_not_is_refused(register, channel, limits):
    with pytest.raises(ProtocolError, match=f"{register}: channel {channel}, must be an integer in {limits}"):
        ABS.select(ABS.find(register), channel)


@pytest.mark.parametrize(
    ("register", "value", "limits"),
    [("pwm_width", 4096, "0..4095"), ("pwm_mode", 2, "0..1"), ("pwm_prescaler", -1, "0..65535")],
)
def test_a_setting_out_of_range_is_refused(register, value, limits):
    with pytest.raises(ProtocolError, match=f"{register} = {value}: must be an integer in {limits}"):
        ABS.write(ABS.find(register), value, channel=0)


@pytest.mark.parametrize("name", [name for name, row in MAP.items() if not row[3] and not row[4]])
def test_thresholds_flags_and_measurements_are_never_written(name):
    with pytest.raises(ProtocolError, match=f"{name} is read-only"):
        ABS.write(ABS.find(name), 0)


def test_the_converters_registers_are_thresholds_in_the_abs_logic():
    assert COLLISIONS == (0xA0, 0xA4, 0xA8)
    pairs = {(ABS.at(offset)[0].name, GENERIC.at(offset)[0].name) for offset in COLLISIONS}
    assert pairs == {
        ("resistor2_high", "ad_mux"),
        ("minimum_supply", "ad_control"),
        ("maximum_temperature", "ad_result"),
    }


@pytest.mark.parametrize(
    ("register", "here"), [(rtdac_pci.AD_MUX, "resistor2_high"), (rtdac_pci.AD_CONTROL, "minimum_supply")]
)
def test_the_converter_cannot_be_written_through_the_abs_map(register, here):
    with pytest.raises(ProtocolError, match=f"ABS logic 0x050F has no {register.name}: .* is {here}"):
        ABS.write(register, 0)


def test_alarm_flags_are_unknown_and_say_that_nothing_may_rest_on_them():
    flags = ABS.at(172)
    assert [flag.low for flag in flags] == [0, 1, 2]
    assert {flag.status for flag in flags} == {Status.UNKNOWN}
    assert all("advisory only" in flag.meaning and "K2" in flag.meaning for flag in flags)
    assert ["K1" in flag.meaning for flag in flags] == [True, False, True]


def test_other_registers_are_confirmed_except_the_nibbles_of_the_channel_counts():
    doubtful = {register.name for register in ABS.registers.values() if register.status is not Status.CONFIRMED}
    assert doubtful == {"pwm_encoder_channels", "alarm_bit0", "alarm_supply", "alarm_bit2"}


@pytest.mark.parametrize(
    ("raw", "count"),
    [(0, 0), (1, 1), (2**31 - 1, 2**31 - 1), (2**31, -(2**31)), (2**32 - 1, -1), (2**32 - 4096, -4096)],
)
def test_the_encoder_counter_is_signed(raw, count):
    assert rtdac_pci.ENCODER_COUNT.decode(raw) == count


@given(raw=st.integers(0, 2**32 - 1))
def test_every_32_bits_decode_to_values_in_range(raw):
    for register in ABS.registers.values():
        value = register.decode(raw)
        assert type(value) is int
        if not register.channels:
            assert register.range[0] <= value <= register.range[1]
            assert register.encode(value) == raw & register.mask


@pytest.mark.parametrize(("count", "volts"), [(0, 0.0), (92_000, 1.0), (4000, 23.0), (7480, 12.3)])
def test_supply(count, volts):
    assert supply_volts(count) == pytest.approx(volts, abs=0.005)
    assert ABS.quantity(rtdac_pci.SUPPLY, {"supply": count}) == supply_volts(count)


@pytest.mark.parametrize(
    ("lines", "window", "rpm"),
    [
        # what the manual's screens show, in a window of 50, 5 and 0.5 ms
        (130, 2_000_000, 152),
        (1400, 2_000_000, 1641),
        (1500, 2_000_000, 1758),
        (2000, 2_000_000, 2344),
        (200, 200_000, 2344),
        (20, 20_000, 2344),
        (0, 20_000, 0),
    ],
)
def test_velocity(lines, window, rpm):
    assert velocity_rpm(lines, window) == pytest.approx(rpm, abs=0.5)
    for register in (rtdac_pci.ROAD_VELOCITY, rtdac_pci.WHEEL_VELOCITY, rtdac_pci.MAXIMUM_ROAD_VELOCITY):
        values = {register.name: lines, "velocity_window": window}
        assert ABS.quantity(register, values) == velocity_rpm(lines, window)


@given(lines=st.integers(0, 0xFFFF), window=st.integers(1, 2**32 - 1))
def test_velocity_is_lines_per_time(lines, window):
    minutes = window / 40e6 / 60
    assert velocity_rpm(lines, window) == pytest.approx(lines / 1024 / minutes)


def test_a_velocity_without_a_window_is_not_a_standstill():
    with pytest.raises(ProtocolError, match="velocity_window = 0"):
        velocity_rpm(0, 0)


@pytest.mark.parametrize(("ticks", "us"), [(20_000, 500), (200_000, 5_000), (2_000_000, 50_000), (0, 0), (1, 0.025)])
def test_window(ticks, us):
    assert window_us(ticks) == us


@pytest.mark.parametrize(
    ("high", "low", "celsius"), [(1, 2, 35.0), (535, 1000, 21.0), (387.5, 1000, 80.0), (0, 9, 0), (9, 0, 0)]
)
def test_the_temperature_follows_from_the_two_pulses(high, low, celsius):
    assert temperature_celsius(high, low) == pytest.approx(celsius)


def test_temperature_takes_the_high_pulse_first():
    values = {"temperature_low": 1000, "temperature_high": 535}
    for register in (rtdac_pci.TEMPERATURE_HIGH, rtdac_pci.TEMPERATURE_LOW):
        assert ABS.quantity(register, values) == pytest.approx(21.0)


@pytest.mark.parametrize("register", [r for r in ABS.registers.values() if r.conversion], ids=lambda r: r.name)
def test_every_conversion_works_on_its_own_registers(register):
    assert register.name in register.conversion.inputs
    assert isinstance(ABS.quantity(register, dict.fromkeys(register.conversion.inputs, 1000)), float)
