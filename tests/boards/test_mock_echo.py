import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import READ, READ_REQUEST, SEND, decode_read, decode_send

ECHOED = sorted(set(SEND.fields) & set(READ.fields))

# words as the host sends them, and the same settings as the board reports them
PAIRS = {
    "PWM 0, 8-bit, prescaler 44": ({20: 44, 21: 0, 22: 128}, {20: 44, 21: 0, 22: 128}),
    "PWM 1, 12-bit, prescaler 2": ({23: 2, 24: 2, 25: 4095}, {23: 2, 24: 1, 25: 4095}),
    "PWM 0, 8-bit, prescaler 65535": ({20: 0x7FFF, 21: 1, 22: 1}, {20: 0xFFFF, 21: 0, 22: 1}),
    "PWM 1, 12-bit, prescaler 32768": ({23: 0, 24: 3, 25: 1}, {23: 0x8000, 24: 1, 25: 1}),
    "PWM 7, 12-bit, prescaler 65534": ({41: 0x7FFE, 42: 3, 43: 7}, {41: 0xFFFE, 42: 1, 43: 7}),
    "all pins' mode": ({10: 0x7FFF, 11: 0x7FF}, {10: 0xFFFF, 11: 0x3FF}),
    "pin 15 is an input": ({12: 0, 13: 1}, {12: 0x8000, 13: 0}),
    "pin 16 is an input": ({12: 0, 13: 2}, {12: 0, 13: 1}),
    "pin 25 is high": ({14: 0, 15: 1 << 10}, {14: 0, 15: 1 << 9, 17: 1 << 9}),
    "pin 25 is high and an input": (
        {12: 0, 13: 1 << 10, 14: 0, 15: 1 << 10},
        {12: 0, 13: 1 << 9, 14: 0, 15: 1 << 9, 17: 0},
    ),
    "encoder reset": ({50: 0xA8}, {50: 0xA8}),
    "encoder index": ({51: 0x81, 52: 0x18}, {51: 0x81, 52: 0x18}),
    "timers": ({70: 3, 71: 1}, {70: 3, 71: 1}),
    "gate time of meter 1": ({92: 0x7FFF, 93: 0x7FFF}, {92: 0xFFFF, 93: 0x3FFF}),
    "chronometer 7": ({147: 0xC57, 162: 0x1234, 163: 1}, {147: 0xC57, 162: 0x9234, 163: 0}),
    "gains of the last converters": ({203: 0x4321}, {203: 0x4321}),
    "analogue output 3": ({223: 0x3FFF}, {223: 0x3FFF}),
}


def test_the_header_names_logic_application_date_and_channels(mock):
    answer = mock.read()
    assert len(answer) == 504
    assert answer[0:2] == bytes.fromhex("0301")
    assert answer[2:8] == b"MISSBA"
    assert answer[8:12] == bytes.fromhex("01012620")
    assert answer[12:18] == bytes.fromhex("880820800800")


def test_the_header_is_the_same_regardless_of_what_was_written(mock, wire):
    before = mock.read()[:18]
    mock.front_end.bulk_out(wire.frame(dict.fromkeys(range(1, 252), 0x7FFF)))
    assert mock.read()[:18] == before


def test_before_anything_was_written_all_settings_are_zero(mock):
    values = decode_read(mock.read())
    assert {values[name] for name in ECHOED} == {0}


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_settings_are_echoed_in_the_encoding_of_the_read_frame(mock, wire, pair):
    sent, reported = pair
    expected = wire.words(mock.read())
    for index, value in reported.items():
        expected[index] = value
    mock.front_end.bulk_out(wire.frame(sent))
    answer = wire.words(mock.read())
    counters = range(53, 57)  # hold-and-release of a counter is tested elsewhere
    assert {i: word for i, word in enumerate(answer) if i not in counters} == {
        i: word for i, word in enumerate(expected) if i not in counters
    }


@pytest.mark.untraced
@given(words=st.lists(st.integers(0, 0x7FFF), min_size=251, max_size=251))
def test_every_setting_of_any_frame_is_echoed(new_mock, wire, words):
    mock, frame = new_mock(), wire.frame(dict(enumerate(words, 1)))
    mock.front_end.bulk_out(frame)
    sent, reported = decode_send(frame), decode_read(mock.read())
    assert {name: reported[name] for name in ECHOED} == {name: sent[name] for name in ECHOED}
    assert reported["pin_input"] == sent["pin_output"] & ~sent["pin_direction"]


def test_a_read_without_a_request_gives_no_answer(mock):
    assert mock.front_end.bulk_in(504) == b""
    mock.read()
    assert mock.front_end.bulk_in(504) == b""


def test_a_frame_with_settings_is_not_answered(mock):
    mock.send(pwm0_width=1)
    assert mock.front_end.bulk_in(504) == b""


def test_every_request_has_one_answer_in_order_as_of_the_request(mock):
    for width in (1, 2, 3):
        mock.send(pwm0_width=width)
        mock.front_end.bulk_out(READ_REQUEST)
    widths = [decode_read(mock.front_end.bulk_in(504))["pwm0_width"] for _ in range(3)]
    assert widths == [1, 2, 3]
    assert mock.front_end.bulk_in(504) == b""


def test_an_answer_is_cut_to_the_length_asked_for(mock):
    mock.front_end.bulk_out(READ_REQUEST)
    assert len(mock.front_end.bulk_in(64)) == 64


def test_answers_do_not_change_once_they_were_given(mock):
    first = mock.read()
    copy = bytes(first)
    mock.send(pwm0_width=200, pin_output=5)
    mock.read()
    assert first == copy
