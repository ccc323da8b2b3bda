import pytest
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from google.protobuf.timestamp_pb2 import Timestamp

from inteco_abs.format.schema import (
    LOG_NAME,
    PARAMETERS_NAME,
    TICK,
    TRUTH,
    log_descriptor,
    parameters_descriptor,
)
from inteco_abs.signals import Phase, Reason

TICK_FIELDS = [
    ("time_ns", "FIXED64"),
    ("tick", "FIXED32"),
    ("dt_s", "DOUBLE"),
    ("wheel_count", "SFIXED64"),
    ("road_count", "SFIXED64"),
    ("board_flags", "FIXED32"),
    ("stop_request", "ENUM"),
    ("wheel_speed_rad_s", "DOUBLE"),
    ("road_speed_rad_s", "DOUBLE"),
    ("slip", "DOUBLE"),
    ("estimate_valid", "BOOL"),
    ("phase", "ENUM"),
    ("slip_reference", "DOUBLE"),
    ("switching", "DOUBLE"),
    ("torque_demand_nm", "DOUBLE"),
    ("drive_request", "DOUBLE"),
    ("brake_request", "DOUBLE"),
    ("drive", "DOUBLE"),
    ("brake", "DOUBLE"),
    ("reason", "ENUM"),
    ("c0", "DOUBLE"),
    ("c1", "DOUBLE"),
    ("c2", "DOUBLE"),
    ("c3", "DOUBLE"),
    ("late_us", "FLOAT"),
    ("io_us", "FLOAT"),
    ("busy_us", "FLOAT"),
    ("skipped", "FIXED32"),
]
TRUTH_FIELDS = [
    ("time_ns", "FIXED64"),
    ("wheel_speed_rad_s", "DOUBLE"),
    ("road_speed_rad_s", "DOUBLE"),
    ("slip", "DOUBLE"),
    ("brake_torque_nm", "DOUBLE"),
    ("drive", "DOUBLE"),
    ("brake", "DOUBLE"),
    ("adhesion", "DOUBLE"),
]
LOG_FIELDS = [
    ("timestamp", 1, "MESSAGE"),
    ("level", 2, "ENUM"),
    ("message", 3, "STRING"),
    ("name", 4, "STRING"),
    ("file", 5, "STRING"),
    ("line", 6, "FIXED32"),
]
DESCRIPTORS = {
    "inteco_abs.v1.Tick": TICK.descriptor(),
    "inteco_abs.v1.Truth": TRUTH.descriptor(),
    PARAMETERS_NAME: parameters_descriptor(),
    LOG_NAME: log_descriptor(),
}
BY_NAME = pytest.mark.parametrize("name", DESCRIPTORS)


def found(descriptor):
    """(name, number, type) of every field, in the order of the file."""
    return [(field.name, field.number, type_name(field.type)) for field in descriptor.fields]


def type_name(number):
    return FieldDescriptorProto.Type.Name(number).removeprefix("TYPE_")


def members_of(enum):
    return {value.name: value.number for value in enum.values}


@BY_NAME
def test_descriptor_loads_in_the_official_pool(message_class, name):
    assert message_class(DESCRIPTORS[name], name).DESCRIPTOR.full_name == name


@BY_NAME
def test_descriptor_holds_nothing_that_the_official_library_does_not_know(name):
    files = FileDescriptorSet.FromString(DESCRIPTORS[name])
    files.DiscardUnknownFields()
    assert files.ByteSize() == len(DESCRIPTORS[name])


@BY_NAME
def test_every_file_is_proto3_and_brings_what_it_imports(name):
    files = FileDescriptorSet.FromString(DESCRIPTORS[name]).file
    seen = set()
    for file in files:
        assert file.syntax == "proto3"
        assert seen.issuperset(file.dependency)
        seen.add(file.name)


@pytest.mark.parametrize(("message", "expected"), [(TICK, TICK_FIELDS), (TRUTH, TRUTH_FIELDS)], ids=["tick", "truth"])
def test_fields_of_a_flat_message(message_class, message, expected):
    descriptor = message_class(message.descriptor(), message.name).DESCRIPTOR
    assert found(descriptor) == [(name, number, kind) for number, (name, kind) in enumerate(expected, 1)]
    assert not any(field.is_repeated or field.containing_oneof for field in descriptor.fields)


@pytest.mark.parametrize("message", [TICK, TRUTH], ids=["tick", "truth"])
def test_descriptor_numpy_type_and_table_name_the_same_fields(message_class, message):
    descriptor = message_class(message.descriptor(), message.name).DESCRIPTOR
    names = [column.name for column in message.columns]
    assert [field.name for field in descriptor.fields] == names == list(message.dtype.names)
    assert [field.type for field in descriptor.fields] == [column.kind.type_number for column in message.columns]


def test_topics():
    assert (TICK.topic, TRUTH.topic) == ("/abs/tick", "/sim/truth")


@pytest.mark.parametrize(("field", "kind"), [("phase", Phase), ("reason", Reason)])
def test_enums_have_every_member_under_its_number(message_class, field, kind):
    enum = message_class(TICK.descriptor(), TICK.name).DESCRIPTOR.fields_by_name[field].enum_type
    assert enum.full_name == f"inteco_abs.v1.{kind.__name__}"
    assert members_of(enum) == {f"{kind.__name__.upper()}_{member.name}": member.value for member in kind}


@pytest.mark.parametrize("kind", [Phase, Reason])
def test_enum_values_fit_one_byte_of_a_varint(kind):
    assert min(kind) == 0
    assert max(kind) < 128


def test_parameters_are_a_map_of_doubles_and_a_tick(message_class):
    parameters = message_class(parameters_descriptor(), PARAMETERS_NAME)
    values, tick = parameters.DESCRIPTOR.fields
    assert found(parameters.DESCRIPTOR) == [("values", 1, "MESSAGE"), ("tick", 2, "FIXED32")]
    assert values.is_repeated
    assert not tick.is_repeated
    assert values.message_type.GetOptions().map_entry
    assert found(values.message_type) == [("key", 1, "STRING"), ("value", 2, "DOUBLE")]
    assert dict(parameters(values={"Mk": 2.0}).values) == {"Mk": 2.0}


def test_log_is_foxglove_log(message_class):
    descriptor = message_class(log_descriptor(), LOG_NAME).DESCRIPTOR
    assert found(descriptor) == LOG_FIELDS
    levels = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
    level = descriptor.fields_by_name["level"].enum_type
    assert level.full_name == "foxglove.Log.Level"
    assert members_of(level) == {name: number for number, name in enumerate(levels)}


def test_time_stamp_of_the_log_is_protobufs_own(message_class):
    stamp = message_class(log_descriptor(), LOG_NAME).DESCRIPTOR.fields_by_name["timestamp"].message_type
    assert stamp.full_name == Timestamp.DESCRIPTOR.full_name
    assert found(stamp) == found(Timestamp.DESCRIPTOR)
