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


def test_short_application_name_is_padded_at_its_end():
    frame = encode_read({"application_name": "ABS"})
    assert frame[2:8] == b"\0\0\0SBA"
    assert decode_read(frame)["application_name"] == "ABS"


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
