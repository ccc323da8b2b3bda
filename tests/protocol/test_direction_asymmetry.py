import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import SEND, decode_read, encode_read, encode_send


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("pin_mode", 10), ("pin_direction", 12), ("pin_output", 14),
        ("frequency_meter3_timer", 96), ("chronometer5_divider", 158),
    ],
)  # fmt: skip
@settings(deadline=None)
@given(value=st.integers(0, 2**26 - 1))
def test_a_setting_of_two_words_is_cut_at_16_bits_on_read_and_at_15_on_send(name, word, value, words_of):
    read, sent = words_of(encode_read({name: value})), words_of(encode_send({name: value}))
    assert read[word : word + 2] == [value % 2**16, value // 2**16]
    assert sent[word : word + 2] == [value % 2**15, value // 2**15]


@pytest.mark.untraced
@pytest.mark.parametrize("channel", range(8))
@settings(deadline=None)
@given(prescaler=st.integers(0, 2**16 - 1), mode=st.integers(0, 1))
def test_pwm_mode_makes_room_for_the_prescalers_top_bit_on_send(channel, prescaler, mode, words_of):
    values = {f"pwm{channel}_prescaler": prescaler, f"pwm{channel}_mode": mode}
    word = 20 + 3 * channel
    assert words_of(encode_read(values))[word : word + 2] == [prescaler, mode]
    assert words_of(encode_send(values))[word : word + 2] == [
        prescaler % 2**15,
        2 * mode + prescaler // 2**15,
    ]


@pytest.mark.parametrize("name", ["frequency_meter0_timer", "chronometer7_divider"])
def test_a_read_value_may_be_wider_than_what_can_be_sent(name):
    assert decode_read(encode_read({name: 2**32 - 1}))[name] == 2**32 - 1
    with pytest.raises(ValueError, match=rf"{name} = {2**30}: .*0\.\.{2**30 - 1}"):
        encode_send({name: 2**30})


def test_bit_15_of_every_sent_data_word_is_zero_even_for_the_largest_values(words_of):
    largest = {name: field.range(layout)[1] for name, (field, layout) in SEND.fields.items()}
    sent = words_of(encode_send(largest))
    assert sent[0] == 0x8F0F
    assert [index for index, word in enumerate(sent[1:], start=1) if word & 0x8000] == []
