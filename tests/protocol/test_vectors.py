import pytest

from firmware_protocol import rtdac_usb2
from firmware_protocol.pwm import pwm_frequency_hz
from firmware_protocol.rtdac_usb2 import decode_read, decode_send, encode_read, encode_send


def test_read_request_is_the_command_word_and_two_bytes_of_padding():
    assert bytes.fromhex("FF 8F 00 00") == rtdac_usb2.READ_REQUEST


def test_send_frame_starts_with_its_command_word_and_has_504_bytes():
    frame = encode_send({})
    assert frame[:2] == bytes.fromhex("0F 8F")
    assert len(frame) == 504
    assert not any(frame[2:])


def test_pwm0_8_bit_prescaler_44_width_128():
    values = {"pwm0_mode": 0, "pwm0_prescaler": 44, "pwm0_width": 128}
    assert encode_send(values)[40:46] == bytes.fromhex("2C 00 00 00 80 00")
    assert encode_read(values)[40:46] == bytes.fromhex("2C 00 00 00 80 00")


def test_pwm1_12_bit_prescaler_2_width_4095_moves_its_mode_bit_on_read_back():
    values = {"pwm1_mode": 1, "pwm1_prescaler": 2, "pwm1_width": 4095}
    assert encode_send(values)[46:52] == bytes.fromhex("02 00 02 00 FF 0F")
    assert encode_read(values)[46:52] == bytes.fromhex("02 00 01 00 FF 0F")


def test_encoder_1_at_minus_one():
    frame = bytearray(504)
    frame[110:114] = bytes.fromhex("FF FF FF FF")
    assert decode_read(frame)["encoder1_count"] == -1
    assert encode_read({"encoder1_count": -1}) == frame


def test_application_name_travels_last_character_first():
    frame = bytearray(504)
    frame[2:8] = bytes.fromhex("46 45 44 43 42 41")
    assert decode_read(frame)["application_name"] == "ABCDEF"
    assert encode_read({"application_name": "ABCDEF"}) == frame


def test_short_application_name_is_padded_at_its_end():
    frame = encode_read({"application_name": "ABS"})
    assert frame[2:8] == b"\0\0\0SBA"
    assert decode_read(frame)["application_name"] == "ABS"


def test_synthesis_date_is_read_in_hex_digits():
    frame = bytearray(504)
    frame[8:12] = bytes.fromhex("06 06 11 20")
    assert decode_read(frame)["synthesis_date"] == "20110606"


@pytest.mark.parametrize("buffer", [bytes, bytearray, memoryview])
def test_decoders_take_any_byte_buffer(buffer):
    assert decode_read(buffer(encode_read({"pwm0_width": 7})))["pwm0_width"] == 7
    assert decode_send(buffer(encode_send({"pwm0_width": 7})))["pwm0_width"] == 7


@pytest.mark.parametrize(
    ("mode", "prescaler", "frequency_hz"),
    [(0, 44, 3485.8), (1, 2, 3256.0), (1, 7, 1221.0), (0, 7, 19607.8), (1, 60, 160.13), (0, 522, 299.93)],
)
def test_pwm_frequency_of_published_settings(mode, prescaler, frequency_hz):
    assert pwm_frequency_hz(mode, prescaler) == pytest.approx(frequency_hz, rel=2e-5)


def test_endpoints_are_the_data_pair_and_never_jtag():
    assert (rtdac_usb2.ENDPOINT_OUT, rtdac_usb2.ENDPOINT_IN) == (0x02, 0x84)
