import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import READ_REQUEST, SEND_COMMAND

DRIVING = {"pin_mode": 0b100100, "pwm0_width": 200, "pwm1_width": 30, "pin_output": 9}


def assert_rejected(mock, message):
    before, duties, rejected = mock.read(), mock.device.duties, mock.front_end.rejected
    mock.front_end.bulk_out(message)
    assert mock.front_end.rejected == rejected + 1
    assert mock.front_end.bulk_in(504) == b""
    assert mock.read() == before
    assert mock.device.duties == duties


@pytest.fixture
def driving(mock):
    mock.send(**DRIVING)
    return mock


@pytest.mark.parametrize("length", [0, 1, 2, 3, 5, 502, 503, 505, 506, 512, 1008])
def test_a_message_of_a_wrong_length_changes_nothing(driving, wire, length):
    assert_rejected(driving, (wire.frame({}) * 2)[:length])


@pytest.mark.parametrize("command", [0, 0x8FFF, 0x0F8F, 0x8F0E, 0x0F0F, 0xFFFF])
def test_a_frame_with_another_command_word_changes_nothing(driving, wire, command):
    assert_rejected(driving, wire.frame({22: 1}, command))


@pytest.mark.parametrize("word", [1, 9, 20, 22, 25, 50, 251])
def test_a_frame_with_bit_15_in_a_data_word_changes_nothing(driving, wire, word):
    assert_rejected(driving, wire.frame({10: 0b100100, 14: 9, 22: 1, 25: 30, word: 0x8001}))


def test_a_frame_whose_widths_alone_have_bit_15_changes_nothing(mock, wire):
    mock.front_end.bulk_out(wire.frame({10: 0b100100, 22: 200}))
    assert_rejected(mock, wire.frame({10: 0b100100, 22: 0x8000 | 200}))
    assert_rejected(mock, wire.frame({10: 0b100100, 22: 200, 25: 0x8000}))


@given(message=st.binary(min_size=4, max_size=4).filter(lambda message: message != READ_REQUEST))
def test_four_bytes_that_are_no_request_change_nothing(new_mock, message):
    mock = new_mock()
    mock.send(**DRIVING)
    assert_rejected(mock, message)


def test_a_good_frame_after_a_bad_one_is_accepted(driving, wire):
    driving.front_end.bulk_out(wire.frame({22: 0x8000}, SEND_COMMAND))
    driving.send(**{**DRIVING, "pwm0_width": 51})
    assert driving.front_end.rejected == 1
    assert driving.device.duties[0] == 0.2


def test_good_messages_are_not_counted_as_rejected(driving):
    driving.read()
    driving.send(**DRIVING)
    assert driving.front_end.rejected == 0
