import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import READ, READ_REQUEST, SEND, decode_read, decode_send

ECHOED = sorted(set(SEND.fields) & set(READ.fields))


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
