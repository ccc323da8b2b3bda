import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import READ, SEND, decode_read, decode_send, encode_send
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.mock_board import Cable

ECHOED = sorted(set(SEND.fields) & set(READ.fields))
CABLES = [Cable(), Cable(drive_pwm=5, brake_pwm=2, road_encoder=3, wheel_encoder=0)]

# mostly frames that differ in a width or two, and among them changes of anything, repeated frames and bad ones
widths = st.integers(0, 4095) | st.sampled_from([0, 255, 256, 4095])
any_word = st.integers(0, 0x7FFF)
change = st.one_of(
    st.fixed_dictionaries({22: widths}),
    st.fixed_dictionaries({25: widths}),
    st.fixed_dictionaries({22: widths, 25: widths}),
    st.fixed_dictionaries({37: widths, 28: widths}),
    st.fixed_dictionaries({41: any_word, 22: widths}),
    st.sampled_from([{41: 0x8001}, {42: 1}, {42: 2}, {42: 0}, {42: 0x8000}]),
    st.sampled_from([{}, {10: 0b100100}, {10: 0x7FFF, 11: 0x7FF, 12: 0, 13: 0}, {50: 3}, {50: 0}, {70: 3}, {70: 0}]),
    st.sampled_from([{71: 3}, {21: 2}, {21: 1}, {24: 3}, {24: 0}, {12: 4}, {12: 0}, {22: 0x8000}, {25: 0xFFFF}]),
    st.sampled_from([{22: 0x7001}, {25: 0x1000}, {9: 1}, {9: 0}, {0: 0x8FFF}, {0: 0x8F0F}]),
    st.dictionaries(st.integers(1, 251), any_word, max_size=4),
)
scripts = st.lists(st.tuples(change, st.sampled_from([0, 0, 500_000, 7_000_001])), max_size=25)
patient = settings(suppress_health_check=[HealthCheck.too_slow])


def frames_of(wire, script):
    """Each frame is the one before with some words changed; those that the board rejects are left behind."""
    words = {0: 0x8F0F}
    for changes, elapsed_ns in script:
        trial = {**words, **changes}
        frame = wire.frame({i: w for i, w in trial.items() if i}, trial[0])
        good = trial[0] == 0x8F0F and all(word < 0x8000 for index, word in trial.items() if index)
        if good:
            words = trial
        yield frame, good, elapsed_ns


@pytest.mark.untraced
@patient
@given(script=scripts, cable=st.sampled_from(CABLES))
@example(script=[({25: 4096}, 0), ({25: 0}, 0)], cable=CABLES[0])
@example(script=[({15: 0x1800}, 0), ({15: 0}, 0)], cable=CABLES[0])
def test_a_front_end_that_remembers_answers_as_one_that_decodes_every_frame(new_mock, wire, script, cable):
    mock, twin = new_mock(cable=cable), new_mock(cable=cable)
    rejected = 0
    for frame, good, elapsed_ns in frames_of(wire, script):
        mock.front_end.bulk_out(frame)
        if good:
            twin.front_end = Usb2FrontEnd(twin.device)  # knows nothing of earlier frames
            twin.front_end.bulk_out(frame)
        rejected += not good
        assert mock.read() == twin.read()
        assert mock.device.duties == twin.device.duties
        mock.clock.advance(elapsed_ns)
        twin.clock.advance(elapsed_ns)
        assert mock.read() == twin.read()
    assert mock.front_end.rejected == rejected


@pytest.mark.untraced
@patient
@given(script=scripts)
def test_the_settings_are_those_of_the_last_good_frame_alone(new_mock, wire, script):
    mock, last = new_mock(), None
    for frame, good, _ in frames_of(wire, script):
        mock.front_end.bulk_out(frame)
        last = frame if good else last
    if last is None:
        assert mock.device.settings == {}
        return
    fresh = new_mock()
    fresh.front_end.bulk_out(last)
    assert mock.device.settings == fresh.device.settings == decode_send(last)
    assert mock.device.duties == fresh.device.duties
    reported, fresh_answer = decode_read(mock.read()), decode_read(fresh.read())
    assert {name: reported[name] for name in ECHOED} == {name: fresh_answer[name] for name in ECHOED}
    assert {name: reported[name] for name in ECHOED} == {name: decode_send(last)[name] for name in ECHOED}
    assert reported["pin_input"] == fresh_answer["pin_input"]


def test_a_written_buffer_is_copied(mock, wire):
    buffer = bytearray(wire.frame({10: 0b100100, 22: 10}))
    mock.front_end.bulk_out(buffer)
    buffer[44] = 200
    mock.front_end.bulk_out(buffer)
    assert mock.device.duties[0] == 200 / 255
    buffer[28] = 1
    mock.front_end.bulk_out(buffer)
    assert decode_read(mock.read())["pin_output"] == 1


def test_a_frame_that_is_dropped_does_not_change_the_number_that_is_echoed(new_mock):
    mock = new_mock()
    mock.send(pwm7_prescaler=5)
    image = bytearray(encode_send({"pwm7_prescaler": 6}))
    image[101] |= 0x80  # a data word with the command bit
    mock.front_end.bulk_out(bytes(image))
    assert decode_read(mock.read())["pwm7_prescaler"] == 5
    mock.send(pwm7_prescaler=7)
    assert decode_read(mock.read())["pwm7_prescaler"] == 7
