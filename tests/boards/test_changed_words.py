from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import READ_REQUEST, encode_read, encode_send
from inteco_abs.errors import ConfigError
from inteco_abs.wire.capture import Capture, Record, RecordKind
from inteco_abs.wire.changed_words import changed_words, compare_sends
from inteco_abs.wire.summary import summarize


def with_word(frame, word, value):
    return frame[: 2 * word] + value.to_bytes(2, "little") + frame[2 * word + 2 :]


def capture(frames, kind=RecordKind.OUT, board="usb2"):
    return Capture(board, "", "", tuple(Record(0.01 * n, kind, None, frame) for n, frame in enumerate(frames)))


def counting(count, **values):
    """SEND frames, numbered in a prescaler."""
    return [encode_send({"pwm7_prescaler": number, **values}) for number in range(1, count + 1)]


def test_an_unknown_word_moved_by_a_slider_comes_first():
    frames = counting(100)
    for number in range(30, 40):  # the slider
        frames[number:] = [with_word(frame, 45, 10 * number) for frame in frames[number:]]
    for number in (10, 35, 80):  # a lamp, once together with the slider
        frames[number:] = [with_word(frame, 14, number) for frame in frames[number:]]
    first, second, last = changed_words(capture(frames))
    assert (first.direction, first.word, first.byte_offset, first.fields) == ("SEND", "w45", 90, ("unknown",))
    assert (first.minimum, first.maximum, first.distinct, first.changes) == (0, 390, 11, 10)
    assert (first.course, first.restless) == ("rises", False)
    assert (first.first_s, first.last_s) == (pytest.approx(0.30), pytest.approx(0.39))
    assert first.alone == pytest.approx(0.9)
    assert (second.word, second.fields) == ("w14", ("pin_output",))
    assert second.alone == pytest.approx(2 / 3)
    assert (last.word, last.restless, last.course) == ("w41", True, "rises")
    assert last.alone == pytest.approx(87 / 99)


def test_unknown_candidate_comes_first_of_two_equal_ones():
    frames = [encode_send({}) for _ in range(50)]
    frames[10:] = [with_word(frame, 22, 5) for frame in frames[10:]]
    frames[20:] = [with_word(frame, 225, 5) for frame in frames[20:]]
    assert [word.word for word in changed_words(capture(frames))] == ["w225", "w22"]


def test_a_counter_that_wraps_is_seen_to_rise_and_its_reverse_to_fall():
    up = [encode_read({"encoder0_count": 65500 + 7 * number}) for number in range(20)]
    assert [word.course for word in changed_words(capture(up, RecordKind.IN))] == ["rises", "rises"]
    assert [word.course for word in changed_words(capture(up[::-1], RecordKind.IN))] == ["falls", "falls"]


def test_a_word_that_rises_and_falls_has_both_directions():
    frames = [encode_read({"ad0_result": value}) for value in (0, 5, 3)]
    (word,) = changed_words(capture(frames, RecordKind.IN))
    assert (word.direction, word.course, word.bits, word.fields) == ("READ", "both ways", 0x7, ("ad0_result",))


def test_bits_that_no_field_owns_are_unknown_beside_those_that_one_does():
    frames = [encode_send({}), with_word(encode_send({}), 22, 0x1001)]
    (word,) = changed_words(capture(frames))
    assert word.fields == ("pwm0_width", "unknown")


def test_data_bytes_of_the_first_generation_are_named():
    frames = [b"\x81" + bytes(149), b"\x81" + bytes(23) + b"\x05" + bytes(125)]
    (word,) = changed_words(capture(frames, board="usb1-111"))
    assert (word.word, word.byte_offset) == ("b23", 24)
    assert word.fields == ("pwm0_prescaler", "unknown")


def test_a_capture_without_frames_has_nothing_that_moved():
    assert changed_words(capture([READ_REQUEST, b"x"])) == []


@given(st.lists(st.dictionaries(st.integers(1, 251), st.integers(0, 0x7FFF), max_size=4), min_size=1, max_size=12))
def test_what_moved_is_just_what_has_more_than_one_value(changes):
    frames = []
    for words in changes:
        frame = encode_send({})
        for word, value in words.items():
            frame = with_word(frame, word, value)
        frames.append(frame)
    found = changed_words(capture(frames))
    columns = {word: [frame[2 * word : 2 * word + 2] for frame in frames] for word in range(252)}
    assert {one.byte_offset // 2 for one in found} == {word for word, column in columns.items() if len(set(column)) > 1}
    for one in found:
        values = [int.from_bytes(value, "little") for value in columns[one.byte_offset // 2]]
        assert (one.minimum, one.maximum, one.distinct) == (min(values), max(values), len(set(values)))
        assert one.changes == sum(a != b for a, b in pairwise(values))
        assert 0 <= one.alone <= 1


def test_two_captures_that_send_the_same_are_the_same():
    assert compare_sends(capture(counting(5)), capture([READ_REQUEST, *counting(5)])).same


def test_a_word_that_two_captures_send_differently_is_named_with_its_first_values():
    outcome = compare_sends(capture(counting(5)), capture(counting(5, pwm0_width=9)))
    (word,) = outcome.words
    assert (outcome.differing_frames, word.word, word.frames, word.fields) == (5, "w22", 5, ("pwm0_width",))
    assert (word.first_frame, word.first_value, word.second_value) == (1, 0, 9)


def test_frame_numbers_are_not_a_difference_when_their_field_is_ignored():
    one, other = capture(counting(5)), capture(counting(6)[1:])
    assert not compare_sends(one, other).same
    assert compare_sends(one, other, ["pwm7_prescaler"]).same


def test_more_frames_on_one_side_are_a_difference():
    outcome = compare_sends(capture(counting(5)), capture(counting(4)))
    assert (outcome.differing_frames, outcome.first_frames, outcome.second_frames) == (0, 5, 4)
    assert not outcome.same


def test_an_unknown_field_cannot_be_ignored():
    with pytest.raises(ConfigError, match="did you mean pwm7_prescaler"):
        compare_sends(capture([]), capture([]), ["pwm7_prescale"])


def test_a_summary_counts_messages_and_their_rates():
    frame = encode_read({"logic_version": 0x0103, "application_name": "ABS1"})
    records = []
    for number in range(11):
        records += [
            Record(0.01 * number, RecordKind.OUT, 2, READ_REQUEST),
            Record(0.01 * number + 0.001, RecordKind.IN, 0x84, frame),
        ]
    records.append(Record(0.2, RecordKind.ERROR, text="no answer", of="in"))
    summary = summarize(Capture("usb2", "", "", tuple(records)))
    request = summary.traffic["READ request"]
    assert (request.messages, request.rate_hz) == (11, pytest.approx(100))
    assert request.longest_interval_s == pytest.approx(0.01)
    assert summary.traffic["READ answer"].messages == 11
    assert (summary.errors, summary.duration_s) == ({"no answer": 1}, pytest.approx(0.2))
    assert (summary.logic_version, summary.application_name, summary.caution) == (0x0103, "ABS1", "")


@pytest.mark.parametrize(
    ("board", "frame"), [("usb2", b"\x05\x02" + bytes(502)), ("usb1-111", b"\x05\x02" + bytes(148))]
)
def test_another_logic_than_the_tables_is_warned_of(board, frame):
    summary = summarize(capture([frame], RecordKind.IN, board))
    assert summary.logic_version == 0x0205
    assert "logic 0x0205" in summary.caution


def test_an_empty_capture_has_a_summary():
    summary = summarize(capture([]))
    assert (summary.traffic, summary.duration_s, summary.logic_version) == ({}, 0.0, None)
