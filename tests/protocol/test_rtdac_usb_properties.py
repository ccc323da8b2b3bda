from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_protocol import ProtocolError, ValueKind
from firmware_protocol.rtdac_usb import LOGICS, decode_read, decode_send, encode_read, encode_send, logic_of

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

whole_table = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
each_logic = pytest.mark.parametrize("logic", sorted(LOGICS), ids=hex)
frames = st.binary(min_size=150, max_size=150)
anything = st.none() | st.integers() | st.floats() | st.text() | st.booleans() | st.binary()


def values_of(table):
    def value(field, layout):
        if field.name in table.fixed:
            return st.just(table.fixed[field.name])
        if field.kind is ValueKind.TEXT:
            return st.text(st.characters(min_codepoint=1, max_codepoint=127), max_size=5)
        return st.integers(*field.range(layout))

    return st.fixed_dictionaries({}, optional={name: value(*place) for name, place in table.fields.items()})


SENT = st.sampled_from(sorted(LOGICS)).flatmap(lambda v: st.tuples(st.just(v), values_of(LOGICS[v].send)))
ANSWERED = st.sampled_from(sorted(LOGICS)).flatmap(lambda v: st.tuples(st.just(v), values_of(LOGICS[v].read)))


@whole_table
@given(case=SENT)
def test_the_board_understands_every_value_the_host_sends(case):
    logic, values = case
    nothing = decode_send(encode_send({}, logic=logic), logic=logic)
    assert decode_send(encode_send(values, logic=logic), logic=logic) == {**nothing, **values}


@whole_table
@given(case=ANSWERED)
def test_the_host_reads_every_value_the_board_answers(case):
    logic, values = case
    nothing = decode_read(encode_read({}, logic=logic), logic=logic)
    assert decode_read(encode_read(values, logic=logic), logic=logic) == {**nothing, **values}


@each_logic
@given(frame=frames)
def test_any_answer_of_this_logic_encodes_back_to_the_same_declared_bits(logic, frame):
    frame = logic.to_bytes(2, "little") + frame[2:]
    declared = bytearray(150)
    for _, layout in logic_of(logic).read.fields.values():
        for part in layout:
            declared[part.word] |= (2**part.width - 1) << part.low
    kept = bytes(a & b for a, b in zip(frame, declared, strict=True))
    assert encode_read(decode_read(frame, logic=logic), logic=logic) == kept


@each_logic
@given(frame=frames)
def test_any_send_frame_encodes_back_to_the_same_declared_bits(logic, frame):
    frame = b"\x81" + bytes(byte & 0x7F for byte in frame[1:])
    declared = bytearray(b"\xff" + bytes(149))
    for _, layout in logic_of(logic).send.fields.values():
        for part in layout:
            declared[part.word + 1] |= (2**part.width - 1) << part.low
    kept = bytes(a & b for a, b in zip(frame, declared, strict=True))
    assert encode_send(decode_send(frame, logic=logic), logic=logic) == kept


@each_logic
@given(frame=frames, command=st.integers(0, 0xFF).filter(lambda byte: byte != 0x81))
def test_a_frame_with_another_command_is_never_taken_as_a_send_frame(logic, frame, command):
    with pytest.raises(ProtocolError, match=f"command byte 0x{command:02X}, must be 0x81"):
        decode_send(bytes([command]) + frame[1:], logic=logic)


@each_logic
@given(data=st.data(), value=anything)
def test_a_value_is_either_carried_unchanged_or_refused(logic, data, value):
    name = data.draw(st.sampled_from(sorted(logic_of(logic).read.fields)))
    with suppress(ProtocolError):
        decoded = decode_read(encode_read({name: value}, logic=logic), logic=logic)[name]
        assert decoded == value
        assert type(decoded) is type(value)
