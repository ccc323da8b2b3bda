"""Logic 0x0111 of the firmware against the Python tables, and against the mock board."""

import pytest
from benches import SteeredDevice
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from firmware_protocol.c_header import VENDOR_NAME
from firmware_protocol.open_board import VENDOR_WATCHDOG_MS
from firmware_protocol.rtdac_usb import DUMMY, LOGICS, READ_REQUEST, decode_read, encode_send
from inteco_abs.boards.families.usb.mock import ByteStream, UsbFrontEnd
from inteco_abs.config import load_config

LOGIC = LOGICS[0x0111]
WATCHDOG_US = 1000 * VENDOR_WATCHDOG_MS
PINS_END = 20
BOTH_ON = {"pin_mode": 3, "pwm0_mode": 1, "pwm0_width": 4095, "pwm1_width": 200, "pwm0_prescaler": 2}


def send(**values):
    return encode_send(values, logic=0x0111)


def asked(board):
    return decode_read(board.asked(READ_REQUEST), logic=0x0111)


def fitting(field):
    low, high = field.range(field.send)
    return st.sampled_from((low, high)) | st.integers(low, high)


any_settings = st.fixed_dictionaries(
    {}, optional={name: fitting(field) for name, (field, _) in LOGIC.send.fields.items()}
)
any_stream = st.lists(
    st.one_of(
        any_settings.map(lambda values: encode_send(values, logic=0x0111)),
        st.binary(min_size=149, max_size=149).map(lambda data: b"\x81" + bytes(byte & 0x7F for byte in data)),
        st.just(READ_REQUEST),
        st.binary(max_size=4).map(lambda data: data.replace(b"\xa5", b"")),
        st.tuples(any_settings, st.integers(0, 150)).map(lambda pair: encode_send(pair[0], logic=0x0111)[: pair[1]]),
    ),
    max_size=6,
)


class MockBoard:
    """The mock board of the vendor's logic, whose clock is the firmware's."""

    def __init__(self, board):
        config = load_config(profile="sim_usb")
        device = SteeredDevice(config, lambda: board.clock_us * 1000)
        device.seize()
        device.show(0, 0)
        self.stream = ByteStream(UsbFrontEnd(device))
        self.stream.feed(send(pin_direction=0x3FFFFFF))  # as the firmware has them at power-up

    def answers(self, data):
        return [self._same(answer) for answer in _frames(self.stream.feed(data))]

    def _same(self, frame):
        return {**decode_read(frame, logic=0x0111), "application_name": VENDOR_NAME}, _unnamed(frame)


def _frames(stream):
    assert len(stream) % 150 == 0
    return [stream[at : at + 150] for at in range(0, len(stream), 150)]


def _unnamed(frame):
    """Bits of no table, but for those beside the highest pins, where the mock board has zeros."""
    found = [byte & ~named for byte, named in zip(frame, LOGIC.read.named_bits, strict=True)]
    del found[PINS_END]
    return found


VECTORS = {
    "8-bit, prescaler 44, width 128": ({22: "2C 00 00 00 01"}, {21: "2C 00 00 80 00"}),
    "12-bit, prescaler 2, width 4095": ({27: "02 00 40 7F 1F"}, {26: "02 00 01 FF 0F"}),
    "the published lab setting": (
        {9: "1F 60 60 0C 00", 22: "41 00 40"},
        {8: "1F 60 30 03 00", 21: "41 00 01"},
    ),
}
"""Bytes of a SEND frame, and of the READ frame then, by their places; as in tests/protocol."""


@pytest.mark.parametrize(("sent", "read"), VECTORS.values(), ids=VECTORS)
def test_vectors(board, sent, read):
    frame = bytearray(b"\x81" + bytes(149))
    for place, data in sent.items():
        frame[place : place + len(bytes.fromhex(data))] = bytes.fromhex(data)
    board.write(frame)
    answer = board.asked(b"\x82")
    assert answer[:8] == bytes.fromhex("11 01 00 42 4E 45 50 4F")  # the name's last character first
    for place, data in read.items():
        assert answer[place : place + len(bytes.fromhex(data))] == bytes.fromhex(data)


def test_a_counter_at_minus_one(board):
    board.turn(1, -1)
    assert board.asked(b"\x82")[49:53] == bytes.fromhex("FF FF FF FF")


class TestAsTheTablesSay:
    def test_at_power_up_all_is_off_and_the_pins_are_inputs(self, board):
        assert board.widths == (0, 0)
        assert board.driven == (0, 0)
        found = asked(board)
        assert (found.pop("logic_version"), found.pop("application_name")) == (0x0111, VENDOR_NAME)
        assert found.pop("pin_direction") == 0x3FFFFFF
        assert set(found.values()) == {0}

    @given(any_settings)
    @settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
    def test_a_read_frame_repeats_what_a_send_frame_set(self, board, values):
        board.reset()
        board.write(encode_send(values, logic=0x0111))
        found = asked(board)
        assert {name: found[name] for name in LOGIC.send.fields} == {**dict.fromkeys(LOGIC.send.fields, 0), **values}

    @given(any_stream, st.integers(0, 40_000))
    @settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
    @example([send(timer_mode=3, timer_reset=1), send(timer_mode=3), READ_REQUEST], 40_000)
    @example([send(timer_mode=3, timer_reset=2), send(timer_mode=3), READ_REQUEST], 40_000)
    def test_it_answers_as_the_mock_board(self, board, messages, pause_us):
        board.reset()
        mock = MockBoard(board)
        for message in [*messages, READ_REQUEST]:
            frames = [(decode_read(frame, logic=0x0111), _unnamed(frame)) for frame in _frames(board.asked(message))]
            assert frames == mock.answers(message)
            board.advance(pause_us)


class TestOutputs:
    def test_a_width_is_on_where_the_pin_is_a_pwm_pin(self, board):
        board.write(send(**BOTH_ON))
        assert board.pwm == ((4095, 1, 2), (200, 0, 0))
        board.write(send(**BOTH_ON | {"pin_mode": 2}))
        assert board.widths == (0, 200)

    def test_in_8_bit_mode_the_low_8_bits_of_a_width_count(self, board):
        board.write(send(pin_mode=1, pwm0_width=0x1FF))
        assert board.widths == (255, 0)

    def test_pins_are_driven_where_their_direction_is_output(self, board):
        board.write(send(pin_direction=0x0FFFFFF, pin_output=0x3000001))
        assert board.driven == (0x3000000, 0x3000000)
        board.inputs = 0x2000003
        assert asked(board)["pin_input"] == 0x3000003


class TestWatchdog:
    def test_the_outputs_go_off_at_the_first_tick_after_its_time(self, board):
        board.advance(300)
        board.write(send(**BOTH_ON))
        board.advance(WATCHDOG_US - 1)
        assert board.widths == (4095, 200)
        board.advance(1000)
        assert board.widths == (0, 0)

    def test_only_a_send_frame_feeds_it(self, board):
        board.write(send(**BOTH_ON))
        for _ in range(WATCHDOG_US // 1000):
            board.asked(DUMMY + READ_REQUEST + b"\x83\x00" + send(**BOTH_ON)[:149])
            board.advance(1000)
        assert board.widths == (0, 0)

    def test_each_send_frame_feeds_it(self, board):
        for _ in range(5):
            board.write(send(**BOTH_ON))
            board.advance(WATCHDOG_US - 1000)
            assert board.widths == (4095, 200)

    def test_widths_after_a_trip_stay_zero_until_a_send_frame_has_them_all_zero(self, board):
        board.write(send(**BOTH_ON, pwm2_width=7))
        board.advance(WATCHDOG_US)
        found = asked(board)
        assert [found[f"pwm{i}_width"] for i in range(3)] == [0, 0, 7]
        assert found["pwm0_prescaler"] == 2
        board.write(send(**BOTH_ON))
        assert board.widths == (0, 0)
        assert asked(board)["pwm0_width"] == 0
        board.write(send(**BOTH_ON | {"pwm0_width": 0, "pwm1_width": 0}))
        board.write(send(**BOTH_ON))
        assert board.widths == (4095, 200)

    def test_with_all_widths_zero_it_does_not_run(self, board):
        board.write(send(pin_mode=3))
        board.advance(2 * WATCHDOG_US)
        board.write(send(**BOTH_ON))
        assert board.widths == (4095, 200)

    def test_the_clocks_wrap_changes_nothing(self, board):
        board.clock_us = 2**32 - WATCHDOG_US // 2
        board.write(send(**BOTH_ON))
        board.advance(WATCHDOG_US - 1)
        assert board.widths == (4095, 200)
        board.advance(1000)
        assert board.widths == (0, 0)


def test_data_bytes_without_a_command_are_ignored(board):
    board.write(send(**BOTH_ON) + send()[1:] + bytes(200))
    assert board.widths == (4095, 200)


def test_a_reset_drops_an_unfinished_frame(board):
    board.write(send(**BOTH_ON)[:100])
    board.reset()
    board.write(send(**BOTH_ON)[100:])
    assert board.widths == (0, 0)


def test_an_answer_that_does_not_fit_is_not_cut(board):
    board.room = 299
    assert len(board.asked(2 * READ_REQUEST)) == 150


def test_counters_are_held_while_their_bit_is_set(board):
    for channel in range(4):
        board.turn(channel, -1 - channel)
    assert [asked(board)[f"encoder{i}_count"] for i in range(4)] == [-1, -2, -3, -4]
    board.write(send(encoder_reset=0b0101))
    for channel in range(4):
        board.turn(channel, 10)
    assert [asked(board)[f"encoder{i}_count"] for i in range(4)] == [0, 8, 0, 6]
