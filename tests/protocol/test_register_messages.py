import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import ProtocolError
from firmware_protocol.register_messages import (
    READ,
    answer_bytes,
    decode_answer,
    decode_request,
    encode_answer,
    encode_request,
)
from firmware_protocol.registers import Write

words = st.integers(0, 2**32 - 1)
offsets = st.integers(0, READ - 1)
steps = st.lists(offsets | st.builds(Write, offsets, words))


@given(number=words, accesses=steps)
def test_a_request_survives_encoding_and_decoding(number, accesses):
    assert decode_request(encode_request(number, accesses)) == (number, accesses)


@given(number=words, values=st.lists(words))
def test_an_answer_survives_encoding_and_decoding(number, values):
    message = encode_answer(number, values)
    assert len(message) == answer_bytes(len(values))
    assert decode_answer(message) == (number, tuple(values))


def test_the_bytes_of_a_request():
    message = encode_request(0x01020304, [Write(0x60, 1), 0x6C])
    assert message == bytes.fromhex("04030201 60000000 01000000 6c000080 00000000")


def test_the_bytes_of_an_answer():
    assert encode_answer(1, [0x050F, 0xFFFFFFFF]) == bytes.fromhex("01000000 0f050000 ffffffff")


@given(message=st.binary(max_size=64))
def test_any_bytes_decode_to_a_request_or_are_refused(message):
    try:
        number, accesses = decode_request(message)
    except ProtocolError:
        assert len(message) % 8 != 4
    else:
        assert len(message) == 4 + 8 * len(accesses)
        assert message[:4] == number.to_bytes(4, "little")


@pytest.mark.parametrize("message", [b"", b"1", b"123", b"12345"])
def test_a_length_that_is_not_a_multiple_of_a_word_is_not_an_answer(message):
    with pytest.raises(ProtocolError, match=f"{len(message)} bytes"):
        decode_answer(message)


@pytest.mark.parametrize("value", [-1, 2**32])
def test_a_value_of_more_than_32_bits_is_refused(value):
    with pytest.raises(ProtocolError, match="32 bits"):
        encode_request(0, [Write(0, value)])
    with pytest.raises(ProtocolError, match="32 bits"):
        encode_answer(0, [value])
