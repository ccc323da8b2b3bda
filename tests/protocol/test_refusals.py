import re

import pytest

from firmware_protocol import ProtocolError
from firmware_protocol.rtdac_usb2 import READ, SEND, decode_send, encode_read, encode_send

OUT_OF_RANGE = [
    ("pwm0_width", -1, "0..4095"),
    ("pwm7_width", 4096, "0..4095"),
    ("pwm0_mode", 2, "0..1"),
    ("pwm0_prescaler", 65536, "0..65535"),
    ("pin_mode", 1 << 26, "0..67108863"),
    ("pin_direction", -1, "0..67108863"),
    ("encoder_reset", 256, "0..255"),
    ("timer_mode", 4, "0..3"),
    ("frequency_meter_enable", 256, "0..255"),
    ("frequency_meter0_timer", 1 << 30, "0..1073741823"),
    ("chronometer0_control", 4096, "0..4095"),
    ("ad0_gain", 8, "0..7"),
    ("da0_output", 16384, "0..16383"),
]

OUT_OF_RANGE_ON_READ = [
    ("encoder0_count", 2**31, "-2147483648..2147483647"),
    ("encoder7_count", -(2**31) - 1, "-2147483648..2147483647"),
    ("timer0_value", 2**32, "0..4294967295"),
    ("ad0_result", 2048, "-2048..2047"),
    ("ad0_result", -2049, "-2048..2047"),
    ("logic_version", 65536, "0..65535"),
    ("pin_input", 1 << 26, "0..67108863"),
]


@pytest.mark.parametrize(("name", "value", "limits"), OUT_OF_RANGE)
def test_send_refuses_a_value_out_of_range(name, value, limits):
    with pytest.raises(ProtocolError, match=re.escape(f"{name} = {value}") + ".*" + re.escape(limits)):
        encode_send({"pwm1_width": 1, name: value})


@pytest.mark.parametrize(("name", "value", "limits"), OUT_OF_RANGE_ON_READ)
def test_read_refuses_a_value_out_of_range(name, value, limits):
    with pytest.raises(ProtocolError, match=re.escape(f"{name} = {value}") + ".*" + re.escape(limits)):
        encode_read({name: value})


@pytest.mark.parametrize("value", [True, False, 1.0, 0.5, "1", "", b"\x01", None, [1]])
def test_a_number_field_takes_nothing_but_an_integer(value):
    with pytest.raises(ProtocolError, match=re.escape(f"pwm0_width = {value!r}") + r".*0\.\.4095"):
        encode_send({"pwm0_width": value})


@pytest.mark.parametrize("value", ["ABCDEFG", "Ω", "AB\0", b"ABS", 65, None])
def test_the_name_takes_nothing_but_six_characters(value):
    with pytest.raises(ProtocolError, match=re.escape(f"application_name = {value!r}") + ".*at most 6"):
        encode_read({"application_name": value})


@pytest.mark.parametrize(
    "value",
    [20110606, "2011060", "201106060", "2011060G", "2011_606", "+2011060", " 2011060", "٢0110606", None],
)
def test_the_date_takes_nothing_but_eight_hex_digits(value):
    with pytest.raises(ProtocolError, match=re.escape(f"synthesis_date = {value!r}") + ".*8 hex digits"):
        encode_read({"synthesis_date": value})


@pytest.mark.parametrize(
    ("wrong", "near"),
    [("pwm0_widht", "pwm0_width"), ("pin_modes", "pin_mode"), ("encoders_reset", "encoder_reset")],
)
def test_an_unknown_field_is_named_with_its_nearest_match(wrong, near):
    with pytest.raises(ProtocolError, match=f"SEND frame .*'{wrong}'.*did you mean {near}\\?"):
        encode_send({wrong: 0})


def test_an_unknown_field_like_no_other_is_named_without_a_guess():
    with pytest.raises(ProtocolError, match=r"'zzz'$"):
        encode_send({"zzz": 0})


@pytest.mark.parametrize("word", [1, 9, 20, 22, 50, 224, 251])
def test_bit_15_in_any_data_word_of_a_send_frame_is_refused(word, frame_of):
    with pytest.raises(ProtocolError, match=f"word {word} = 0x8001"):
        decode_send(frame_of({word: 0x8001}, command=0x8F0F))


def test_decode_some_checks_the_whole_frame_and_the_names():
    marked = bytearray(encode_send({"pwm0_width": 9}))
    assert SEND.decode_some(marked, ["pwm0_width"]) == {"pwm0_width": 9}
    marked[503] = 0x80
    with pytest.raises(ProtocolError, match="word 251"):
        SEND.decode_some(marked, ["pwm0_width"])
    with pytest.raises(ProtocolError, match="did you mean encoder0_count"):
        READ.decode_some(bytes(504), ["encoder0_counts"])
