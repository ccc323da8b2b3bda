import struct

import pytest
from google.protobuf.empty_pb2 import Empty
from google.protobuf.unknown_fields import UnknownFieldSet
from google.protobuf.wrappers_pb2 import BytesValue, DoubleValue, StringValue, UInt64Value
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.format import protobuf as wire

NUMBERS = st.integers(1, (1 << 29) - 1)
UNSIGNED = st.integers(0, (1 << 64) - 1)
EDGES = [0, 1, 0x7F, 0x80, 0x3FFF, 0x4000, (1 << 32) - 1, 1 << 32, (1 << 63) - 1, 1 << 63, (1 << 64) - 1]


def fields_of(data):
    """(number, wire type, value) of every field that the official parser finds."""
    return [(field.field_number, field.wire_type, field.data) for field in UnknownFieldSet(Empty.FromString(data))]


@pytest.mark.parametrize("value", EDGES)
def test_varint_edges_are_read_back(value):
    assert fields_of(wire.tag(1, 0) + wire.varint(value)) == [(1, 0, value)]


@given(value=UNSIGNED)
def test_integer_is_what_the_official_serialiser_writes(value):
    official = UInt64Value(value=value).SerializeToString()
    assert wire.integer(1, value) == (official or b"\x08\x00")  # the serialiser leaves zeros out


@given(number=NUMBERS, value=UNSIGNED)
@example(number=15, value=0)
@example(number=16, value=0)
@example(number=2047, value=0)
@example(number=2048, value=0)
def test_integer_field_keeps_number_and_value(number, value):
    assert fields_of(wire.integer(number, value)) == [(number, 0, value)]


@given(number=NUMBERS, value=st.floats())
@example(number=1, value=-0.0)
@example(number=1, value=5e-324)
def test_double_field_keeps_number_and_bits(number, value):
    (bits,) = struct.unpack("<Q", struct.pack("<d", value))
    assert fields_of(wire.double(number, value)) == [(number, 1, bits)]


@given(value=st.floats(allow_nan=False).filter(bool))
def test_double_is_what_the_official_serialiser_writes(value):
    assert wire.double(1, value) == DoubleValue(value=value).SerializeToString()


@given(number=NUMBERS, data=st.binary(max_size=300))
def test_bytes_field_keeps_number_and_content(number, data):
    assert fields_of(wire.chunk(number, data)) == [(number, 2, data)]


@given(data=st.binary(min_size=1, max_size=300))
def test_bytes_are_what_the_official_serialiser_writes(data):
    assert wire.chunk(1, data) == BytesValue(value=data).SerializeToString()


@given(text=st.text(min_size=1))
def test_text_is_what_the_official_serialiser_writes(text):
    assert wire.chunk(1, text) == StringValue(value=text).SerializeToString()


@given(number=NUMBERS, bits=st.integers(0, (1 << 32) - 1))
def test_tag_of_a_32_bit_field(number, bits):
    assert fields_of(wire.tag(number, 5) + struct.pack("<I", bits)) == [(number, 5, bits)]


def test_adjacent_fields_do_not_overlap():
    data = wire.integer(3, 300) + wire.chunk(2, "ä") + wire.double(1, 1.5) + wire.chunk(4, b"")
    (bits,) = struct.unpack("<Q", struct.pack("<d", 1.5))
    assert fields_of(data) == [(3, 0, 300), (2, 2, "ä".encode()), (1, 1, bits), (4, 2, b"")]
