import pytest

from firmware_protocol import FrameField, FrameTable, ProtocolError, TableError
from firmware_protocol.fields import Bits, ValueKind, first_word, get_bits, put_bits, words
from firmware_protocol.rtdac_usb import LOGICS as LOGICS_OF_BYTES
from firmware_protocol.rtdac_usb2 import READ, SEND, decode_read, encode_read, encode_send

SETTINGS = {
    "pin_mode": 0x24,
    "pwm0_prescaler": 0xABCD,
    "pwm0_mode": 1,
    "pwm1_prescaler": 44,
    "encoder_reset": 3,
}


@pytest.mark.parametrize("width", range(1, 17))
def test_a_mask_has_a_one_for_each_bit(width):
    assert Bits(0, 3, width).mask == int("1" * width, 2)


@pytest.mark.parametrize("width", [0, 1, 255, 4095])
@pytest.mark.parametrize("channel", range(8))
def test_a_width_packed_in_place_is_what_encode_makes_and_touches_nothing_else(channel, width):
    name = f"pwm{channel}_width"
    frame = bytearray(encode_send(SETTINGS))
    offset, codec = SEND.place(name)
    codec.pack_into(frame, offset, width)
    assert frame == encode_send({**SETTINGS, name: width})


@pytest.mark.parametrize("count", [0, 1, -1, 2**31 - 1, -(2**31), -65536])
@pytest.mark.parametrize("channel", range(8))
def test_a_count_unpacked_in_place_is_what_decode_reads(channel, count):
    name = f"encoder{channel}_count"
    frame = encode_read({name: count, "timer0_value": 2**32 - 1, "encoder_index_invert": 255})
    offset, codec = READ.place(name)
    assert codec.unpack_from(frame, offset) == (decode_read(frame)[name],) == (count,)


@pytest.mark.parametrize("name", ["timer0_value", "timer1_value", "frequency_meter7_result"])
def test_an_unsigned_pair_of_words_is_not_read_as_negative(name):
    offset, codec = READ.place(name)
    assert codec.unpack_from(encode_read({name: 2**32 - 1}), offset) == (2**32 - 1,)


@pytest.mark.parametrize("name", ["pwm0_width", "encoder_reset", "logic_version", "pwm7_mode", "pwm0_prescaler"])
def test_one_word_fields_of_a_read_frame_have_a_place(name):
    offset, codec = READ.place(name)
    assert codec.unpack_from(encode_read({**SETTINGS, name: 1}), offset) == (1,)


@pytest.mark.parametrize("name", ["pin_mode", "pwm0_prescaler", "pwm0_mode", "frequency_meter0_timer", "ad1_gain"])
def test_a_field_cut_over_words_or_beside_bit_0_has_no_place_in_a_send_frame(name):
    with pytest.raises(TableError, match=name):
        SEND.place(name)


@pytest.mark.parametrize("name", ["pin_mode", "pin_input", "application_name", "ad0_result", "ad0_busy"])
def test_a_field_that_needs_decoding_has_no_place_in_a_read_frame(name):
    with pytest.raises(TableError, match=name):
        READ.place(name)


def test_words_that_do_not_follow_each_other_have_no_place():
    layout = (Bits(1, 0, 16, 0), Bits(3, 0, 16, 16))
    apart = FrameTable("test frame", [(FrameField("apart", "meaning", "unit", "source"), layout)], size=8)
    with pytest.raises(TableError, match="apart"):
        apart.place("apart")


def test_words_in_order_have_a_place():
    joined = FrameTable("test frame", [(FrameField("joined", "meaning", "unit", "source"), words(2, 16, 16))], size=8)
    offset, codec = joined.place("joined")
    assert codec.unpack_from(joined.encode({"joined": 0x89ABCDEF}), offset) == (0x89ABCDEF,)


def test_an_unknown_field_has_no_place():
    with pytest.raises(ProtocolError, match="did you mean pwm0_width"):
        SEND.place("pwm0_with")


OF_BYTES = [table for logic in LOGICS_OF_BYTES.values() for table in (logic.read, logic.send)]


@pytest.mark.parametrize("table", [READ, SEND, *OF_BYTES], ids=lambda table: table.title)
def test_bits_put_by_byte_are_what_encode_makes_and_touch_nothing_else(table):
    for name, (field, layout) in table.fields.items():
        if field.kind is ValueKind.UNSIGNED and name not in table.fixed:
            most, parts = field.range(layout)[1], table.bytes_of(name)
            for value in {0, 1, most // 3, most}:
                frame = list(table.encode({name: most}))
                put_bits(frame, parts, value)
                assert bytes(frame) == table.encode({name: value})
                assert get_bits(frame, parts) == value


def test_the_first_word_of_a_prescaler_holds_its_low_bits_both_ways():
    value = 0b1_0101_0101_0101_0101 & 0xFFFF
    for table, mask in ((READ, 0xFFFF), (SEND, 0x7FFF)):
        frame = table.encode({"pwm7_prescaler": value})
        assert get_bits(frame, first_word(table, "pwm7_prescaler")) == value & mask
