"""The layout of a message from a descriptor of another version or of an unknown writer."""

import pytest
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorSet
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.errors import SessionError
from inteco_abs.format.declared_layout import declared_message
from inteco_abs.format.schema import TICK, TRUTH
from inteco_abs.sessions import read_session
from inteco_abs.signals import Phase, Reason

NAME = "elsewhere.Tick"


def descriptor_of(*fields, label=FieldDescriptorProto.LABEL_OPTIONAL):
    """A descriptor made by the official library, with fields as (name, number, type)."""
    found = [FieldDescriptorProto(name=name, number=number, type=kind, label=label) for name, number, kind in fields]
    files = FileDescriptorSet()
    files.file.add(name="a.proto", package="elsewhere", message_type=[DescriptorProto(name="Tick", field=found)])
    return files.SerializeToString()


@pytest.mark.parametrize("message", [TICK, TRUTH], ids=["tick", "truth"])
def test_our_own_descriptor_declares_our_own_layout(message):
    found = declared_message(message.descriptor(), message.name, message.topic).message
    assert found.dtype == message.dtype
    assert found.blank(3) == message.blank(3)


def test_members_of_enumerations_lose_the_name_of_these():
    members = declared_message(TICK.descriptor(), TICK.name, TICK.topic).members
    assert members == {
        "stop_request": {int(reason): reason.name for reason in Reason},
        "reason": {int(reason): reason.name for reason in Reason},
        "phase": {int(phase): phase.name for phase in Phase},
    }


def test_fields_stand_in_the_order_of_their_numbers():
    descriptor = descriptor_of(("b", 20, 1), ("a", 3, 2), ("c", 21, 15))
    found = declared_message(descriptor, NAME, "/abs/tick").message
    assert found.dtype.names == ("a", "b", "c")
    assert (found.size, [found.dtype.fields[name][1] for name in "abc"]) == (1 + 4 + 2 + 8 + 2 + 4, [1, 7, 17])


@pytest.mark.parametrize("kind", [3, 4, 5, 9, 11, 12, 13, 17, 18, 0, 99])
def test_a_type_of_no_constant_width_is_refused(kind):
    with pytest.raises(ValueError, match=r"its elsewhere\.Tick\.x has no constant width"):
        declared_message(descriptor_of(("x", 1, 1)).replace(b"\x28\x01", bytes([0x28, kind])), NAME, "/abs/tick")


def test_a_repeated_field_is_refused():
    with pytest.raises(ValueError, match="no constant width"):
        declared_message(descriptor_of(("x", 1, 1), label=FieldDescriptorProto.LABEL_REPEATED), NAME, "/abs/tick")


@pytest.mark.parametrize(
    "fields",
    [[], [("x", 1, 1), ("x", 2, 1)], [(f"x{n}", n, 1) for n in range(1, 258)]],
    ids=["no field", "two of one name", "too many"],
)
def test_a_message_without_fields_of_their_own_names_is_refused(fields):
    with pytest.raises(ValueError, match="must be 1 to 256 with different names"):
        declared_message(descriptor_of(*fields), NAME, "/abs/tick")


@pytest.mark.parametrize("name", ["", "0", "a b", "a\n"])
def test_a_field_without_a_proper_name_is_refused(name):
    with pytest.raises(ValueError, match="no constant width"):
        declared_message(descriptor_of((name, 1, 1)), NAME, "/abs/tick")


def test_a_message_that_is_not_declared_is_refused():
    with pytest.raises(ValueError, match="it declares no message here"):
        declared_message(TICK.descriptor(), "here", "/abs/tick")


@given(st.binary(max_size=200))
def test_any_bytes_are_refused(data):
    with pytest.raises(ValueError, match=r"."):
        declared_message(data, TICK.name, TICK.topic)


@given(at=st.integers(0, len(TICK.descriptor()) - 1), byte=st.integers(0, 255))
def test_a_descriptor_with_one_wrong_byte_declares_something_or_is_refused(at, byte):
    data = bytearray(TICK.descriptor())
    data[at] = byte
    try:
        found = declared_message(bytes(data), TICK.name, TICK.topic)
    except ValueError:
        return
    assert found.message.dtype.itemsize == found.message.size


def test_a_session_with_a_huge_descriptor_is_refused(container, altered, tiny):
    huge = TICK.descriptor() + bytes(1 << 16)
    records = []
    for record in container.split(tiny.path.read_bytes()):
        if record.opcode != 6:
            records.append(record)
            continue
        raw = container.unpack(record)
        length = len(TICK.descriptor()).to_bytes(4, "little")
        for entry in container.split(raw, 0):
            if entry.opcode == 3 and TICK.descriptor() in entry.content:
                content = entry.content.replace(length + TICK.descriptor(), len(huge).to_bytes(4, "little") + huge)
                raw = raw.replace(bytes(entry), bytes(container.record(3, content)))
        records.append(container.chunk(raw, len(raw), ""))
    with pytest.raises(SessionError, match="/abs/tick is declared in 66"):
        read_session(altered(container.join(records)))
