from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_protocol import ProtocolError, ValueKind
from firmware_protocol.rtdac_usb2 import READ, SEND, decode_read, decode_send, encode_read, encode_send

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

whole_table = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
no_deadline = settings(deadline=None)
frames = st.binary(min_size=504, max_size=504)


def values_of(table):
    def value(field, layout):
        if field.kind is ValueKind.TEXT:
            return st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=6)
        if field.kind is ValueKind.HEX:
            return st.integers(0, 2**32 - 1).map("{:08X}".format)
        return st.integers(*field.range(layout))

    return st.fixed_dictionaries({}, optional={name: value(*place) for name, place in table.fields.items()})


@whole_table
@given(values=values_of(SEND))
def test_the_board_understands_every_value_the_host_sends(values):
    assert decode_send(encode_send(values)) == {**decode_send(encode_send({})), **values}


@whole_table
@given(values=values_of(READ))
def test_the_host_reads_every_value_the_board_answers(values):
    assert decode_read(encode_read(values)) == {**decode_read(encode_read({})), **values}


@whole_table
@given(frame=frames)
def test_any_504_bytes_decode_and_encode_back_to_the_same_declared_bits(frame):
    declared = bytearray(504)
    for _, layout in READ.fields.values():
        for part in layout:
            mask = (2**part.width - 1) << part.low
            declared[2 * part.word] |= mask & 0xFF
            declared[2 * part.word + 1] |= mask >> 8
    assert encode_read(decode_read(frame)) == bytes(a & b for a, b in zip(frame, declared, strict=True))


@no_deadline
@given(frame=frames, command=st.integers(0, 0xFFFF).filter(lambda word: word != 0x8F0F))
def test_a_frame_with_another_command_word_is_never_taken_as_a_send_frame(frame, command):
    with pytest.raises(ProtocolError, match=f"0x{command:04X}"):
        decode_send(command.to_bytes(2, "little") + frame[2:])


@no_deadline
@given(
    name=st.sampled_from(sorted(READ.fields)),
    value=st.none() | st.integers() | st.floats() | st.text() | st.booleans() | st.binary(),
)
def test_a_value_is_either_carried_unchanged_or_refused(name, value):
    with suppress(ProtocolError):
        decoded = decode_read(encode_read({name: value}))[name]
        assert decoded == value
        assert type(decoded) is type(value)
