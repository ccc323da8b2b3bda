import pytest

from firmware_protocol import ProtocolError, rtdac_usb
from firmware_protocol.rtdac_usb import decode_read, decode_send, encode_read, encode_send, logic_of

LOGICS = [0x0111, 0x0112]
each_logic = pytest.mark.parametrize("logic", LOGICS, ids=hex)


def test_commands():
    assert bytes.fromhex("80") == rtdac_usb.DUMMY
    assert rtdac_usb.SEND_COMMAND == 0x81
    assert bytes.fromhex("82") == rtdac_usb.READ_REQUEST
    assert rtdac_usb.SEND_AND_READ_COMMAND == 0x83
    assert rtdac_usb.FRAME_BYTES == 150


@each_logic
def test_send_frame_is_the_command_and_149_data_bytes(logic):
    assert encode_send({}, logic=logic) == b"\x81" + bytes(149)


@each_logic
def test_read_frame_is_150_data_bytes_that_begin_with_the_version(logic):
    assert encode_read({}, logic=logic) == logic.to_bytes(2, "little") + bytes(148)


def test_the_published_lab_setting():
    values = {"pin_mode": 0x1F, "pin_direction": 0x0033060, "pwm0_prescaler": 65, "pwm0_mode": 1}
    frame = encode_send(values, logic=0x0111)
    assert frame[9:14] == bytes([0x1F, 0x60, 0x60, 0x0C, 0x00])
    assert frame[22:25] == bytes([0x41, 0x00, 0x40])
    assert decode_send(frame, logic=0x0111) == {**decode_send(encode_send({}, logic=0x0111), logic=0x0111), **values}


@pytest.mark.parametrize("buffer", [bytes, bytearray, memoryview])
@each_logic
def test_decoders_take_any_byte_buffer(buffer, logic):
    assert decode_read(buffer(encode_read({"pwm0_width": 7}, logic=logic)), logic=logic)["pwm0_width"] == 7
    assert decode_send(buffer(encode_send({"pwm0_width": 7}, logic=logic)), logic=logic)["pwm0_width"] == 7


@pytest.mark.parametrize("version", [0x0111, 0x0112, 0x0103, 0xFFFF])
def test_the_header_is_read_before_the_logic_is_known(version):
    frame = bytearray(150)
    frame[:8] = version.to_bytes(2, "little") + bytes.fromhex("FF 00 00 53 42 41")
    assert rtdac_usb.HEADER.decode(frame) == {"logic_version": version, "application_name": "ABS"}
    assert set(frame[rtdac_usb.HEADER_BYTES :]) == {0}


def test_a_header_needs_the_whole_frame():
    with pytest.raises(ProtocolError, match="8 bytes, must be 150"):
        rtdac_usb.HEADER.decode(bytes(8))


@pytest.mark.parametrize(("logic", "pwm", "encoders"), [(0x0111, 4, 4), (0x0112, 2, 12)])
def test_channels_of_a_logic(logic, pwm, encoders):
    tables = logic_of(logic)
    assert (tables.name, tables.pwm_channels, tables.encoder_channels) == (f"logic 0x{logic:04X}", pwm, encoders)


@pytest.mark.parametrize("width", [0, 1, 127, 128, 255, 4095])
@pytest.mark.parametrize(("logic", "channel"), [*((0x0111, i) for i in range(4)), *((0x0112, i) for i in range(2))])
def test_a_width_packed_in_place_is_what_encode_makes_and_touches_nothing_else(logic, channel, width):
    settings = {"pin_output": 0x2FFFFFF, "pwm0_prescaler": 0xABCD, "pwm1_mode": 1, "encoder_reset": 3}
    name = f"pwm{channel}_width"
    frame = bytearray(encode_send(settings, logic=logic))
    offset, codec = logic_of(logic).send.place(name)
    codec.pack_into(frame, offset, width)
    assert frame == encode_send({**settings, name: width}, logic=logic)
    assert codec.unpack_from(frame, offset) == (width,)
    echo = logic_of(logic).read.place(name)
    assert echo.codec.unpack_from(encode_read({name: width}, logic=logic), echo.offset) == (width,)


@pytest.mark.parametrize("count", [0, 1, -1, 2**31 - 1, -(2**31), -65536])
@pytest.mark.parametrize(("logic", "channel"), [(0x0111, 0), (0x0111, 3), (0x0112, 0), (0x0112, 11)])
def test_a_count_unpacked_in_place_is_what_decode_reads(logic, channel, count):
    name = f"encoder{channel}_count"
    frame = encode_read({name: count, "ad0_result": 0xFFFF}, logic=logic)
    offset, codec = logic_of(logic).read.place(name)
    assert codec.unpack_from(frame, offset) == (decode_read(frame, logic=logic)[name],) == (count,)
