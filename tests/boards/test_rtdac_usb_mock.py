"""The mock RT-DAC/USB on its own: what it takes, what it answers, and what it drops."""

import pytest
from benches import HandClock
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb import DUMMY, FRAME_BYTES, READ_REQUEST, decode_read, encode_send, logic_of
from inteco_abs.boards.families.usb.mock import ByteStream, UsbFrontEnd
from inteco_abs.config import load_config
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board import Device, front_end_of

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

LOGICS = {
    0x0111: ("profile=sim_usb",),
    0x0112: ("profile=sim_usb", "board.logic_version=0x0112", "board.numbering_pwm=-1"),
}


class Mock:
    def __init__(self, logic=0x0111, *settings):
        self.logic = logic
        self.clock = HandClock()
        self.device = Device(load_config(settings=[*LOGICS[logic], *settings]), self.clock.now_ns)
        self.front_end = front_end_of(self.device)

    def send(self, **settings):
        self.front_end.bulk_out(encode_send(settings, logic=self.logic))

    def answer(self):
        self.front_end.bulk_out(READ_REQUEST)
        return self.front_end.bulk_in(FRAME_BYTES)

    def read(self):
        return decode_read(self.answer(), logic=self.logic)


@pytest.fixture(params=LOGICS, ids=lambda logic: f"0x{logic:04X}")
def mock(request):
    return Mock(request.param)


def settings_of(logic):
    fields = logic_of(logic).send.fields
    return st.fixed_dictionaries({name: st.integers(*field.range(layout)) for name, (field, layout) in fields.items()})


def test_the_header_names_logic_and_application(mock):
    answer = mock.answer()
    assert len(answer) == FRAME_BYTES
    assert int.from_bytes(answer[:2], "little") == mock.logic
    assert answer[2:8] == b"\0MISBA"


@given(data=st.data(), logic=st.sampled_from(sorted(LOGICS)))
def test_every_setting_of_any_frame_is_echoed(data, logic):
    sent = data.draw(settings_of(logic))
    mock = Mock(logic)
    mock.send(**sent)
    reported = mock.read()
    assert {name: reported[name] for name in sent} == sent
    assert reported["pin_input"] == sent["pin_output"] & ~sent["pin_direction"]


def test_widths_and_mode_come_back_in_the_encoding_of_the_read_frame():
    mock = Mock()
    frame = bytearray(FRAME_BYTES)
    frame[0] = 0x81
    frame[1 + 21 : 1 + 26] = bytes.fromhex("02 00 40 7f 1f")  # prescaler 2, 12-bit, width 4095
    mock.front_end.bulk_out(frame)
    assert mock.answer()[21:26] == bytes.fromhex("02 00 01 ff 0f")


def test_both_duties_need_their_function_bit(mock):
    mock.send(pin_mode=0b11, pwm0_width=255, pwm1_width=51)
    assert mock.device.duties == (1.0, 0.2)
    mock.send(pin_mode=0b10, pwm0_width=255, pwm1_width=51)
    assert mock.device.duties == (0.0, 0.2)


def test_counters_follow_the_wheels_and_the_others_stand_still(mock):
    before = mock.read()
    mock.send(pin_mode=0b11, pwm0_width=255)
    mock.clock.advance(500_000_000)
    after = mock.read()
    moved = [after[name] - before[name] for name in after if name.endswith("_count")]
    assert len(moved) == logic_of(mock.logic).encoder_channels
    assert moved[0] > 50
    assert moved[1] > 50
    assert not any(moved[2:])


def test_timers_run_at_20_mhz_in_timer_mode_alone():
    mock = Mock()
    mock.send(timer_mode=0b01)
    start = mock.read()["timer0_value"]
    mock.clock.advance(1_000)
    after = mock.read()
    assert (after["timer0_value"] - start, after["timer1_value"]) == (20, 0)


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"\x83",
        b"\x84",
        b"\x81",
        b"\x00",
        READ_REQUEST * 2,
        bytes(FRAME_BYTES),
        b"\x83" + bytes(FRAME_BYTES - 1),
        b"\x81" + bytes(FRAME_BYTES - 2),
        b"\x81" + bytes(FRAME_BYTES),
        b"\x81\x80" + bytes(FRAME_BYTES - 2),
        b"\x81" + bytes(FRAME_BYTES - 2) + b"\xff",
    ],
    ids=range(12),
)
def test_what_is_not_a_message_is_dropped_and_counted(mock, message):
    mock.send(pin_mode=0b11, pwm0_width=200)
    before = mock.answer()
    mock.front_end.bulk_out(message)
    assert mock.front_end.rejected == 1
    assert mock.front_end.bulk_in(FRAME_BYTES) == b""
    assert mock.answer() == before


def test_the_dummy_changes_nothing_and_is_not_answered(mock):
    before = mock.answer()
    mock.front_end.bulk_out(DUMMY)
    assert mock.front_end.bulk_in(FRAME_BYTES) == b""
    assert (mock.answer(), mock.front_end.rejected) == (before, 0)


def test_each_request_has_its_answer_in_order(mock):
    for width in (1, 2, 3):
        mock.send(pwm0_width=width)
        mock.front_end.bulk_out(READ_REQUEST)
    answers = [decode_read(mock.front_end.bulk_in(FRAME_BYTES), logic=mock.logic)["pwm0_width"] for _ in range(3)]
    assert answers == [1, 2, 3]


def test_a_logic_without_tables_is_not_a_mock_board():
    config = load_config(settings=["profile=sim_usb", "board.logic_version=0x0999"])
    with pytest.raises(ConfigError, match="0x0111, 0x0112"):
        front_end_of(Device(config, HandClock().now_ns))


def send_frame(width):
    return encode_send({"pin_mode": 0b11, "pwm0_width": width}, logic=0x0111)


whole_messages = st.one_of(st.just(DUMMY), st.just(READ_REQUEST), st.integers(0, 4095).map(send_frame))
messages = st.one_of(
    whole_messages,
    st.binary(max_size=8),
    st.integers(1, FRAME_BYTES - 1).map(lambda length: send_frame(9)[:length]),
)


class TestByteStream:
    @given(script=st.lists(messages, max_size=12), cuts=st.lists(st.integers(1, 200), max_size=40))
    def test_the_cuts_do_not_matter(self, script, cuts):
        whole, cut = (ByteStream(Mock().front_end) for _ in range(2))
        data = b"".join(script)
        expected, received = whole.feed(data), b""
        for length in [*cuts, len(data)]:
            received += cut.feed(data[:length])
            data = data[length:]
        assert received == expected
        assert cut.front_end.rejected == whole.front_end.rejected
        assert cut.front_end.device.settings == whole.front_end.device.settings

    @given(script=st.lists(whole_messages))
    def test_whole_messages_arrive_as_they_were_sent(self, script):
        twin, stream = Mock().front_end, ByteStream(Mock().front_end)
        for message in script:
            twin.bulk_out(message)
        assert stream.feed(b"".join(script)) == b"".join(iter(lambda: twin.bulk_in(FRAME_BYTES), b""))
        assert stream.front_end.rejected == 0

    @given(junk=st.binary(max_size=400))
    def test_after_any_junk_a_command_byte_begins_a_message(self, junk):
        stream = ByteStream(Mock().front_end)
        stream.feed(junk)
        answer = stream.feed(send_frame(77) + READ_REQUEST)
        assert decode_read(answer[-FRAME_BYTES:], logic=0x0111)["pwm0_width"] == 77

    def test_a_frame_that_is_cut_short_by_a_command_is_dropped(self):
        stream = ByteStream(Mock().front_end)
        answer = stream.feed(send_frame(5)[:100] + READ_REQUEST)
        assert decode_read(answer, logic=0x0111)["pwm0_width"] == 0
        assert stream.front_end.rejected == 1

    def test_send_and_read_in_one_command_is_not_understood(self):
        stream = ByteStream(Mock().front_end)
        assert stream.feed(b"\x83" + send_frame(5)[1:]) == b""
        assert stream.front_end.rejected == 1
        assert isinstance(stream.front_end, UsbFrontEnd)
        assert stream.front_end.device.settings == {}
