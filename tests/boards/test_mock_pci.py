"""The mock's registers, by literal offsets."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.register_messages import decode_answer, encode_request
from firmware_protocol.registers import Write
from inteco_abs.boards.families.pci.mock import PciFrontEnd
from inteco_abs.config import load_config
from inteco_abs.mock_board import Cable, Device

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

VERSION, WINDOW, ROAD_VELOCITY, WHEEL_VELOCITY = 0x00, 0x50, 0x54, 0x58
PWM_INDEX, PWM_MODE, PWM_PRESCALER, PWM_WIDTH = 0x60, 0x64, 0x68, 0x6C
ENCODER_INDEX, ENCODER_RESET, ENCODER_COUNT = 0x80, 0x84, 0x88
RESISTORS, ALARMS = 0x90, 0xAC
WRITTEN = (PWM_INDEX, PWM_MODE, PWM_PRESCALER, PWM_WIDTH, ENCODER_INDEX, ENCODER_RESET)
OFFSETS = range(0, 256, 4)
KNOWN = (
    0x00, 0x04, 0x38, 0x50, 0x54, 0x58, 0x5C, *WRITTEN, 0x88, 0x90, 0x94, 0x98, 0x9C, 0xA0, 0xA4, 0xA8, 0xAC, 0xB4,
    0xB8,
)  # fmt: skip
words = st.integers(0, 2**32 - 1)


class Mock:
    def __init__(self, seed=0, cable=None):
        self.time_ns = 77
        self.truths = []
        config = load_config(profile="sim_pci")
        self.device = Device(config, lambda: self.time_ns, seed, self.truths.append, cable)
        self.front_end = PciFrontEnd(self.device)
        self.read, self.write = self.front_end.read, self.front_end.write

    def width(self, channel, width):
        self.write(PWM_INDEX, channel)
        self.write(PWM_WIDTH, width)

    def counter(self, channel):
        self.write(ENCODER_INDEX, channel)
        return self.read(ENCODER_COUNT)

    def ask(self, *steps):
        self.front_end.bulk_out(encode_request(9, steps))
        answer = self.front_end.bulk_in(4096)
        return decode_answer(answer) if answer else None


@pytest.fixture
def mock():
    return Mock()


def test_it_has_the_abs_logic(mock):
    assert mock.read(VERSION) == 0x050F


@pytest.mark.parametrize(
    ("offset", "value"),
    [
        (WINDOW, 200_000), (0x5C, 200), (0x94, 140), (0x98, 150), (0x9C, 140), (0xA0, 150), (0xA4, 7480), (0xA8, 80),
        (ALARMS, 7),
    ],
)  # fmt: skip
def test_limits_are_those_of_the_manuals_screens(mock, offset, value):
    assert mock.read(offset) == value


def test_its_supply_and_temperature_are_within_their_limits(mock):
    assert 92000 / mock.read(0x38) > 92000 / mock.read(0xA4)
    assert 235 - 400 * mock.read(0xB4) / mock.read(0xB8) == pytest.approx(21.0)


@pytest.mark.parametrize("offset", [offset for offset in OFFSETS if offset not in KNOWN])
def test_a_register_without_a_description_reads_zero(mock, offset):
    assert mock.read(offset) == 0


@pytest.mark.parametrize("offset", [offset for offset in OFFSETS if offset not in WRITTEN])
def test_writes_to_what_no_source_writes_are_dropped_and_counted(mock, offset):
    before = [mock.read(one) for one in OFFSETS]
    mock.write(offset, 0xFFFFFFFF)
    assert mock.front_end.rejected == 1
    assert [mock.read(one) for one in OFFSETS] == before


@pytest.mark.parametrize(("index", "channels"), [(PWM_INDEX, 2), (ENCODER_INDEX, 3)])
def test_an_index_without_a_channel_is_dropped_and_counted(mock, index, channels):
    mock.write(index, channels - 1)
    mock.write(index, channels)
    assert mock.front_end.rejected == 1
    assert mock.read(index) == channels - 1


@given(channel=st.integers(0, 1), mode=words, prescaler=words, width=words)
def test_each_pwm_channel_keeps_its_settings_within_their_bits(channel, mode, prescaler, width):
    mock = Mock()
    mock.write(PWM_INDEX, channel)
    for offset, value in ((PWM_MODE, mode), (PWM_PRESCALER, prescaler), (PWM_WIDTH, width)):
        mock.write(offset, value)
    kept = [mock.read(offset) for offset in (PWM_MODE, PWM_PRESCALER, PWM_WIDTH)]
    assert kept == [mode & 1, prescaler & 0xFFFF, width & 0xFFF]
    mock.write(PWM_INDEX, 1 - channel)
    assert [mock.read(offset) for offset in (PWM_MODE, PWM_PRESCALER, PWM_WIDTH)] == [0, 0, 0]
    assert mock.front_end.rejected == 0


def test_widths_reach_the_motors(mock):
    mock.width(0, 255)
    mock.width(1, 51)
    assert mock.device.duties == (1.0, 0.2)
    mock.write(PWM_INDEX, 0)
    mock.write(PWM_MODE, 1)
    assert mock.device.duties == (255 / 4095, 0.2)


def test_counters_follow_the_wheels_and_the_levers_stays_zero(mock):
    start = [mock.counter(channel) for channel in range(3)]
    mock.device.plant.road_speed = mock.device.plant.wheel_speed = 100.0
    mock.time_ns += 100_000_000
    road, wheel, lever = (mock.counter(channel) for channel in range(3))
    road_turns, wheel_turns = mock.device.plant.road_angle, mock.device.plant.wheel_angle
    per_rad = 2048 / (2 * math.pi)
    assert (road - start[0]) % 2**32 == pytest.approx(road_turns * per_rad, abs=1)
    assert (wheel - start[1]) % 2**32 == pytest.approx(wheel_turns * per_rad, abs=1)
    assert lever == start[2] == 0


def test_another_cable_has_the_wheels_elsewhere():
    mock = Mock(cable=Cable(road_encoder=2, wheel_encoder=0))
    assert mock.counter(1) == 0
    assert mock.counter(2)
    assert mock.counter(0)


def test_a_reset_bit_holds_its_counter_at_zero(mock):
    mock.write(ENCODER_RESET, 0b01)
    mock.device.plant.road_speed = mock.device.plant.wheel_speed = 100.0
    mock.time_ns += 10_000_000
    assert mock.counter(0) == 0
    assert mock.counter(1) != 0
    assert mock.read(ENCODER_RESET) == 0b01


@pytest.mark.parametrize(("rpm", "lines"), [(0, 0), (152, 12), (1700, 145), (2344, 200)])
def test_velocities_are_counted_in_encoder_lines(mock, rpm, lines):
    mock.device.plant.road_speed = rpm * 2 * math.pi / 60
    mock.device.plant.wheel_speed = rpm * math.pi / 60
    assert mock.read(ROAD_VELOCITY) == lines
    assert mock.read(WHEEL_VELOCITY) == lines // 2


def test_velocities_are_instantaneous(mock):
    mock.width(0, 255)
    assert mock.read(ROAD_VELOCITY) == 0
    mock.time_ns += 500_000_000
    assert mock.read(ROAD_VELOCITY) > 0


def test_resistors_are_in_series_except_while_the_wheel_is_fast(mock):
    seen = []
    for lines in (0, 140, 149, 151, 145, 141, 139, 145, 151):
        mock.device.plant.road_speed = (lines + 0.5) / (1024 * 0.005) * 2 * math.pi
        seen.append(mock.read(RESISTORS))
    assert seen == [3, 3, 3, 0, 0, 0, 3, 3, 0]


def test_an_observer_of_the_rig_sees_a_command_once(mock):
    for _ in range(3):
        mock.width(0, 255)
        mock.width(1, 51)
        for offset in OFFSETS:
            mock.read(offset)
        mock.time_ns += 500_000
    assert [(truth.time_ns, truth.drive, truth.brake) for truth in mock.truths] == [
        (77, 1.0, 0.2), (500_077, 1.0, 0.2), (1_000_077, 1.0, 0.2),
    ]  # fmt: skip


@pytest.mark.parametrize("length", [0, 1, 3, 5, 8, 11, 13, 16])
def test_a_malformed_message_is_dropped_and_counted(mock, length):
    mock.front_end.bulk_out(encode_request(1, [Write(PWM_WIDTH, 99), Write(PWM_WIDTH, 98)])[:length])
    assert mock.front_end.rejected == 1
    assert mock.front_end.bulk_in(4096) == b""
    assert mock.read(PWM_WIDTH) == 0


@given(steps=st.lists(st.sampled_from(OFFSETS) | st.builds(Write, st.sampled_from(OFFSETS), words), max_size=30))
def test_messages_do_what_single_accesses_do(steps):
    one, other = Mock(), Mock()
    values = []
    for step in steps:
        if isinstance(step, int):
            values.append(one.read(step))
        else:
            one.write(*step)
    answer = other.ask(*steps)
    assert answer == ((9, tuple(values)) if values else None)
    assert other.device.settings == one.device.settings
    assert other.front_end.rejected == one.front_end.rejected


def test_a_host_that_takes_less_than_an_answer_gets_its_beginning(mock):
    mock.front_end.bulk_out(encode_request(9, [VERSION]))
    assert mock.front_end.bulk_in(5) == bytes.fromhex("09000000 0f")
    assert mock.front_end.bulk_in(5) == b""
