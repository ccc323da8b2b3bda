import pytest

from firmware_protocol import FrameField, FrameTable, ProtocolError, TableError, ValueKind
from firmware_protocol.fields import Bits, CutCodec, bits, words


def field(name, **options):
    return FrameField(name, "meaning", "unit", "source", **options)


def table(*places, size=8, kinds=(), **options):
    fields = [(field(name, kind=dict(kinds).get(name, ValueKind.UNSIGNED)), layout) for name, layout in places]
    return FrameTable("test frame", fields, size=size, word_bits=8, **options)


def sent(*places):
    return table(*places, payload_bits=7, command=0x81, data_from=1)


def test_a_frame_of_bytes_may_have_an_odd_length():
    assert table(("last", bits(4, 0, 8)), size=5).encode({"last": 0xAB}) == bytes.fromhex("00000000AB")


@pytest.mark.parametrize(("size", "word_bits"), [(0, 8), (-1, 8), (0, 16), (7, 16)])
def test_a_frame_has_whole_words(size, word_bits):
    with pytest.raises(TableError, match=f"{size} bytes are not whole words"):
        FrameTable("test frame", [], size=size, word_bits=word_bits)


@pytest.mark.parametrize("word_bits", [0, 7, 12, 32])
def test_words_have_8_or_16_bits(word_bits):
    with pytest.raises(TableError, match=rf"words of {word_bits} bits, must be one of \[8, 16\]"):
        FrameTable("test frame", [], size=8, word_bits=word_bits)


def test_data_bytes_are_counted_from_behind_the_command():
    frame = sent(("first", bits(0, 0, 7)), ("last", bits(6, 6, 1))).encode({"first": 0x55, "last": 1})
    assert frame == bytes.fromhex("81 55 00 00 00 00 00 40")


def test_a_value_is_split_into_seven_bit_parts_low_part_first():
    place = sent(("wide", words(1, 7, 7, 7, 5)))
    frame = place.encode({"wide": 0x2ABCDEF})
    assert frame[2:6] == bytes([0x6F, 0x1B, 0x2F, 0x15])
    assert place.decode(frame) == {"wide": 0x2ABCDEF}


@pytest.mark.parametrize("layout", [bits(7, 0, 1), bits(-1, 0, 1), words(6, 7, 7)])
def test_a_field_may_not_leave_the_data_bytes(layout):
    with pytest.raises(TableError, match="stray leaves the frame"):
        sent(("stray", layout))


def test_a_sent_byte_may_not_use_the_command_bit():
    with pytest.raises(TableError, match="marked leaves the frame"):
        sent(("marked", bits(0, 0, 8)))


def test_a_byte_has_no_bit_8():
    with pytest.raises(TableError, match="wide leaves the frame"):
        table(("wide", bits(0, 4, 5)))


def test_two_fields_may_not_share_a_bit_of_a_byte():
    with pytest.raises(TableError, match="flag and wide share byte 2 bit 3"):
        sent(("wide", words(1, 7, 7)), ("flag", bits(2, 3, 1)))


def test_a_command_that_is_the_first_byte_of_the_data_is_protected():
    with pytest.raises(TableError, match="wrong and the command byte share byte 0 bit 0"):
        table(("wrong", bits(0, 0, 1)), payload_bits=7, command=0x81)


def test_the_only_value_of_a_fixed_field_is_filled_in_and_others_are_refused():
    fixed = table(("version", words(0, 8, 8)), ("rest", bits(2, 0, 8)), fixed={"version": 0x0111})
    assert fixed.encode({"rest": 7}) == fixed.encode({"version": 0x0111, "rest": 7}) == b"\x11\x01\x07" + bytes(5)
    for refuse in (lambda: fixed.encode({"version": 0x0112}), lambda: fixed.decode(b"\x12\x01" + bytes(6))):
        with pytest.raises(ProtocolError, match="test frame: version = 0x0112, must be 0x0111"):
            refuse()


def test_a_fixed_field_is_checked_whichever_fields_are_wanted():
    fixed = table(("version", words(0, 8, 8)), ("rest", bits(2, 0, 8)), fixed={"version": 0x0111})
    with pytest.raises(ProtocolError, match="version = 0x0000"):
        fixed.decode_some(bytes(8), ["rest"])


def test_a_fixed_field_must_be_declared():
    with pytest.raises(TableError, match=r"fixed fields \['version'\] are not all declared"):
        table(("rest", bits(2, 0, 8)), fixed={"version": 1})


@pytest.mark.parametrize(
    ("layout", "kind", "value", "carried"),
    [
        (bits(1, 0, 8), ValueKind.UNSIGNED, 0xAB, "AB"),
        (bits(1, 0, 3), ValueKind.UNSIGNED, 5, "05"),
        (words(1, 8, 8), ValueKind.UNSIGNED, 0xABCD, "CD AB"),
        (words(1, 8, 8), ValueKind.SIGNED, -2, "FE FF"),
        (words(1, 8, 8, 8, 8), ValueKind.UNSIGNED, 0x89ABCDEF, "EF CD AB 89"),
        (words(1, 8, 8, 8, 8), ValueKind.SIGNED, -2, "FE FF FF FF"),
        (words(1, 8, 4), ValueKind.UNSIGNED, 0xABC, "BC 0A"),
        (words(1, 7, 7, 7, 5), ValueKind.UNSIGNED, 0x2ABCDEF, "6F 1B 2F 15"),
    ],
)
def test_a_field_with_bytes_of_its_own_has_a_place(layout, kind, value, carried):
    frames = table(("own", layout), kinds={"own": kind})
    offset, codec = frames.place("own")
    frame = bytearray(8)
    codec.pack_into(frame, offset, value)
    assert frame == frames.encode({"own": value}) == b"\0" + bytes.fromhex(carried).ljust(7, b"\0")
    assert codec.unpack_from(frame, offset) == (value,)


def test_a_place_behind_a_command_counts_from_the_start_of_the_frame():
    frames = sent(("width", words(3, 7, 5)))
    offset, codec = frames.place("width")
    frame = bytearray(frames.encode({}))
    codec.pack_into(memoryview(frame), offset, 4095)
    assert (offset, frame) == (4, bytearray(frames.encode({"width": 4095})))


@pytest.mark.parametrize(
    ("places", "kinds"),
    [
        ([("own", bits(1, 1, 3))], {}),
        ([("own", bits(1, 0, 3)), ("other", bits(1, 3, 1))], {}),
        ([("own", words(1, 7, 7)), ("other", bits(2, 7, 1))], {}),
        ([("own", (Bits(1, 0, 8, 0), Bits(3, 0, 8, 8)))], {}),
        ([("own", words(1, 8, 4))], {"own": ValueKind.SIGNED}),
        ([("own", words(1, 8, 8))], {"own": ValueKind.TEXT}),
        ([("own", words(1, 8, 8))], {"own": ValueKind.HEX}),
        ([("own", bits(1, 0, 8))], {"own": ValueKind.SIGNED}),
    ],
)
def test_a_field_that_needs_decoding_has_no_place(places, kinds):
    with pytest.raises(TableError, match="own has no bytes of its own"):
        table(*places, kinds=kinds).place("own")


@pytest.mark.parametrize("value", [-1, 4096, 1 << 14, 1 << 40])
def test_a_cut_value_that_does_not_fit_cannot_reach_the_command_bit(value):
    frame = bytearray(4)
    with pytest.raises(ProtocolError, match=rf"value {value} at byte 1: must be in 0\.\.4095"):
        CutCodec((7, 5)).pack_into(frame, 1, value)
    assert frame == bytes(4)


def test_a_cut_value_is_read_without_the_unnamed_bits_above_it():
    assert CutCodec((7, 5)).unpack_from(b"\xff\xff", 0) == (4095,)


def test_the_named_bits_are_those_of_the_command_and_of_the_fields():
    assert sent(("low", bits(0, 0, 3)), ("last", bits(6, 6, 1))).named_bits == (0xFF, 0b111, 0, 0, 0, 0, 0, 1 << 6)


@pytest.mark.parametrize(("kind", "layout"), [(ValueKind.TEXT, words(0, 8, 4)), (ValueKind.HEX, words(0, 8, 2))])
def test_text_needs_whole_characters(kind, layout):
    with pytest.raises(TableError, match=r"torn has 1[02] bits, must be a multiple of [84]"):
        table(("torn", layout), kinds={"torn": kind})
