import re

import pytest

from firmware_protocol import ProtocolError
from firmware_protocol.rtdac_usb import decode_read, decode_send, encode_read, encode_send, logic_of

each_logic = pytest.mark.parametrize("logic", [0x0111, 0x0112], ids=hex)

OUT_OF_RANGE = [
    (0x0111, "pwm0_width", -1, "0..4095"),
    (0x0111, "pwm3_width", 4096, "0..4095"),
    (0x0111, "pwm0_mode", 2, "0..1"),
    (0x0111, "pwm0_prescaler", 65536, "0..65535"),
    (0x0111, "pin_mode", 32, "0..31"),
    (0x0111, "pin_direction", 1 << 26, "0..67108863"),
    (0x0111, "encoder_reset", 16, "0..15"),
    (0x0111, "timer_mode", 4, "0..3"),
    (0x0111, "generator_enable", 2, "0..1"),
    (0x0111, "generator_periods", 1 << 32, "0..4294967295"),
    (0x0111, "ad0_gain", 8, "0..7"),
    (0x0111, "da0_output", 16384, "0..16383"),
    (0x0112, "pin_mode", 4, "0..3"),
    (0x0112, "pwm1_width", 4096, "0..4095"),
    (0x0112, "encoder_reset", 4096, "0..4095"),
]

OUT_OF_RANGE_ON_READ = [
    (0x0111, "encoder0_count", 2**31, "-2147483648..2147483647"),
    (0x0112, "encoder11_count", -(2**31) - 1, "-2147483648..2147483647"),
    (0x0111, "timer0_value", 2**32, "0..4294967295"),
    (0x0111, "ad0_result", 65536, "0..65535"),
    (0x0112, "ad0_result", -1, "0..65535"),
    (0x0112, "logic_version", 65536, "0..65535"),
    (0x0112, "pin_input", 1 << 26, "0..67108863"),
]


@pytest.mark.parametrize(("logic", "name", "value", "limits"), OUT_OF_RANGE)
def test_send_refuses_a_value_out_of_range(logic, name, value, limits):
    with pytest.raises(ProtocolError, match=re.escape(f"{name} = {value}") + ".*" + re.escape(limits)):
        encode_send({"pin_output": 1, name: value}, logic=logic)


@pytest.mark.parametrize(("logic", "name", "value", "limits"), OUT_OF_RANGE_ON_READ)
def test_read_refuses_a_value_out_of_range(logic, name, value, limits):
    with pytest.raises(ProtocolError, match=re.escape(f"{name} = {value}") + ".*" + re.escape(limits)):
        encode_read({name: value}, logic=logic)


@pytest.mark.parametrize("value", [True, False, 1.0, 0.5, "1", "", b"\x01", None, [1]])
@each_logic
def test_a_number_field_takes_nothing_but_an_integer(logic, value):
    with pytest.raises(ProtocolError, match=re.escape(f"pwm0_width = {value!r}") + r".*0\.\.4095"):
        encode_send({"pwm0_width": value}, logic=logic)


@pytest.mark.parametrize("value", ["ABCDEF", "Ω", "AB\0", b"ABS", 65, None])
@each_logic
def test_the_name_takes_nothing_but_five_characters(logic, value):
    with pytest.raises(ProtocolError, match=re.escape(f"application_name = {value!r}") + ".*at most 5"):
        encode_read({"application_name": value}, logic=logic)


@pytest.mark.parametrize("logic", [0, 0x0103, 0x0110, 0x0113, 0x050F, -1])
def test_an_unknown_logic_is_refused_and_the_known_ones_are_named(logic):
    refused = re.escape(f"logic = 0x{logic:04X}: must be one of 0x0111, 0x0112")
    for call in (encode_send, encode_read):
        with pytest.raises(ProtocolError, match=refused):
            call({}, logic=logic)
    for call in (decode_send, decode_read):
        with pytest.raises(ProtocolError, match=refused):
            call(bytes(150), logic=logic)


@pytest.mark.parametrize("logic", [None, "0x111", 273.5])
def test_a_logic_version_that_is_not_a_number_is_refused_by_its_text(logic):
    with pytest.raises(ProtocolError, match=re.escape(f"logic = {logic!r}: must be one of 0x0111, 0x0112")):
        logic_of(logic)


def test_the_logic_must_be_named():
    with pytest.raises(TypeError, match="logic"):
        encode_send({})


@pytest.mark.parametrize(
    ("wrong", "near"),
    [("pwm0_widht", "pwm0_width"), ("pin_modes", "pin_mode"), ("encoders_reset", "encoder_reset")],
)
@each_logic
def test_an_unknown_field_is_named_with_its_nearest_match(logic, wrong, near):
    with pytest.raises(ProtocolError, match=f"SEND frame, logic 0x{logic:04X} .*'{wrong}'.*did you mean {near}\\?"):
        encode_send({wrong: 0}, logic=logic)


@pytest.mark.parametrize("name", ["pwm2_width", "encoder_index_active", "timer_mode", "generator_enable"])
def test_a_field_of_the_other_logic_is_refused(name):
    assert encode_send({name: 1}, logic=0x0111)
    with pytest.raises(ProtocolError, match=f"SEND frame, logic 0x0112 has no field '{name}'"):
        encode_send({name: 1}, logic=0x0112)


@pytest.mark.parametrize("byte", [0, 8, 20, 24, 41, 140, 148])
@each_logic
def test_bit_7_in_any_data_byte_of_a_send_frame_is_refused(byte, logic):
    frame = bytearray(encode_send({}, logic=logic))
    frame[byte + 1] = 0x81
    with pytest.raises(ProtocolError, match=f"byte {byte} = 0x81, data bytes must be below 0x80"):
        decode_send(frame, logic=logic)


@pytest.mark.parametrize(("logic", "other"), [(0x0111, 0x0112), (0x0112, 0x0111)])
def test_an_answer_of_the_other_logic_is_refused_and_cannot_be_made(logic, other):
    refused = f"logic 0x{logic:04X}: logic_version = 0x{other:04X}, must be 0x{logic:04X}"
    with pytest.raises(ProtocolError, match=refused):
        decode_read(encode_read({}, logic=other), logic=logic)
    with pytest.raises(ProtocolError, match=refused):
        encode_read({"logic_version": other}, logic=logic)
