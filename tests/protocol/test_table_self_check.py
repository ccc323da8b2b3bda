import pytest

from firmware_protocol import FrameField, FrameTable, ProtocolError, TableError
from firmware_protocol.fields import Bits, bits, words


def table(*places, size=8, **options):
    fields = [(FrameField(name, "meaning", "unit", "source"), layout) for name, layout in places]
    return FrameTable("test frame", fields, size=size, **options)


def test_neighbouring_fields_may_fill_a_word():
    frame = table(("low", bits(1, 0, 8)), ("high", bits(1, 8, 8))).encode({"low": 0x34, "high": 0x12})
    assert frame == bytes.fromhex("0000 3412 0000 0000")


def test_two_fields_may_not_share_a_bit():
    with pytest.raises(TableError, match="second and first share word 1 bit 7"):
        table(("first", bits(1, 0, 8)), ("second", bits(1, 7, 8)))


def test_two_fields_may_not_share_the_second_word_of_one():
    with pytest.raises(TableError, match="flag and wide share word 3 bit 2"):
        table(("wide", words(2, 16, 16)), ("flag", bits(3, 2, 1)))


def test_a_field_may_not_share_bits_with_itself():
    with pytest.raises(TableError, match="folded"):
        table(("folded", (Bits(1, 0, 8, 0), Bits(1, 4, 8, 8))))


def test_a_name_may_not_be_declared_twice():
    with pytest.raises(TableError, match="'twin' is declared twice"):
        table(("twin", bits(1, 0, 1)), ("twin", bits(2, 0, 1)))


@pytest.mark.parametrize("name", ["", "two words", "1st", "a-b"])
def test_a_name_must_be_an_identifier(name):
    with pytest.raises(TableError, match="is not a name"):
        table((name, bits(1, 0, 1)))


@pytest.mark.parametrize(
    "layout",
    [
        bits(4, 0, 1),
        bits(-1, 0, 1),
        bits(0, 16, 1),
        bits(0, 12, 5),
        bits(0, -1, 2),
        bits(0, 0, 0),
        bits(0, 0, -1),
        words(3, 16, 16),
    ],
)
def test_a_field_may_not_leave_the_frame(layout):
    with pytest.raises(TableError, match="stray leaves the frame"):
        table(("stray", layout))


def test_the_last_bit_of_the_frame_may_be_used():
    assert table(("last", bits(3, 15, 1))).encode({"last": 1}) == bytes(7) + b"\x80"


def test_a_field_may_not_touch_the_command_word():
    with pytest.raises(TableError, match="wrong and the command word share word 0 bit 3"):
        table(("wrong", bits(0, 3, 1)), command=0x8F0F)


def test_a_data_word_may_not_use_the_command_bit():
    with pytest.raises(TableError, match="marked leaves the frame"):
        table(("marked", bits(1, 0, 16)), payload_bits=15, command=0x8F0F)


@pytest.mark.parametrize(
    "layout",
    [
        (Bits(1, 0, 8, 0), Bits(2, 0, 8, 9)),
        (Bits(1, 0, 8, 0), Bits(2, 0, 8, 7)),
        (Bits(1, 0, 8, 1),),
        (Bits(2, 0, 8, 8), Bits(1, 0, 8, 0)),
    ],
)
def test_the_parts_of_a_value_must_join_without_gap_or_overlap(layout):
    with pytest.raises(TableError, match="torn has a gap or overlap"):
        table(("torn", layout))


def test_table_and_protocol_errors_are_value_errors():
    assert issubclass(TableError, ValueError)
    assert issubclass(ProtocolError, ValueError)
