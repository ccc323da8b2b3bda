"""The container as it is written: byte for byte what the reference writer makes of the same messages."""

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from inteco_abs.sessions.container import DecompressionBudget, FixedRun, Opcode, chunk_parts, unpack_chunk
from inteco_abs.sessions.mcap_writer import McapWriter, Messages
from inteco_abs.sessions.scanner import RecordFile

NAMES = st.text(max_size=5)
FACTS = st.dictionaries(NAMES, NAMES, max_size=3)
TIMES = st.integers(0, 2**64 - 1)
STEPS = st.one_of(
    st.tuples(st.just("block"), st.integers(0, 1), st.lists(TIMES, max_size=40)),
    st.tuples(st.just("message"), st.integers(0, 1), TIMES, st.binary(max_size=300)),
    st.tuples(st.just("metadata"), NAMES, FACTS),
    st.tuples(st.just("attachment"), TIMES, NAMES, st.binary(max_size=100)),
    st.tuples(st.just("declare"), NAMES, FACTS),
    st.tuples(st.just("flush")),
)


def by_reference(steps, chunk_bytes):
    file = BytesIO()
    writer = Writer(file, chunk_size=chunk_bytes, enable_data_crcs=True)
    writer.start(library="test")
    channels = [writer.register_channel("/a", "protobuf", writer.register_schema("s", "protobuf", b"d"))] * 2
    for kind, *values in steps:
        match kind, values:
            case "block", (at, times):
                for number, time in enumerate(times):
                    writer.add_message(channels[at], time, bytes([number]) * 9, time, (2**32 - 3 + number) % 2**32)
            case "message", (at, time, data):
                writer.add_message(channels[at], time, data, time, 7)
            case "metadata", (name, facts):
                writer.add_metadata(name, facts)
            case "attachment", (time, name, data):
                writer.add_attachment(time, time, name, "text/plain", data)
            case "declare", (name, facts):
                schema = writer.register_schema(name, "protobuf", b"")
                channels[1] = writer.register_channel(name, "protobuf", schema, facts)
            case _:
                writer.flush()
    writer.finish()
    return file.getvalue()


def by_ours(steps, chunk_bytes):
    file = BytesIO()
    writer = McapWriter(file, "test", chunk_bytes)
    channels = [writer.add_channel("/a", writer.add_schema("s", b"d"), {})] * 2
    for kind, *values in steps:
        match kind, values:
            case "block", (at, times):
                data = np.frombuffer(b"".join(bytes([number]) * 9 for number in range(len(times))), "V9")
                writer.add_messages(Messages(channels[at], 2**32 - 3, np.array(times, np.uint64), data))
            case "message", (at, time, data):
                writer.add_message(channels[at], time, data, 7)
            case "metadata", (name, facts):
                writer.add_metadata(name, facts)
            case "attachment", (time, name, data):
                writer.add_attachment(time, name, "text/plain", data)
            case "declare", (name, facts):
                channels[1] = writer.add_channel(name, writer.add_schema(name, b""), facts)
            case _:
                writer.end_chunk()
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize("chunk_bytes", [100, 600, 1 << 20])
@given(steps=st.lists(STEPS, max_size=12))
def test_a_file_is_what_the_reference_writer_makes_of_the_same_messages(chunk_bytes, steps):
    assert by_ours(steps, chunk_bytes) == by_reference(steps, chunk_bytes)


@given(times=st.lists(TIMES, max_size=60), size=st.integers(0, 20))
def test_messages_in_turns_are_those_of_the_reference_and_are_read_as_two_runs(times, size):
    file, expected = BytesIO(), BytesIO()
    ours, reference = McapWriter(file, "test"), Writer(expected, enable_data_crcs=True)
    reference.start(library="test")
    known = [
        reference.register_channel(name, "protobuf", reference.register_schema(name, "protobuf", b"")) for name in "ab"
    ]
    channels = [ours.add_channel(name, ours.add_schema(name, b""), {}) for name in "ab"]
    for number, time in enumerate(times):
        reference.add_message(known[0], time, bytes(size), time, number)
        reference.add_message(known[1], time, bytes(9), time, 5 + number)
    stamps = np.array(times, np.uint64)
    streams = [(channels[0], 0, size), (channels[1], 5, 9)]
    ours.add_messages(*(Messages(one, first, stamps, np.zeros(len(times), f"V{of}")) for one, first, of in streams))
    reference.finish()
    ours.finish()
    assert file.getvalue() == expected.getvalue()
    if len(times) > 1:
        entries = RecordFile(BytesIO(file.getvalue()), len(file.getvalue()))
        (chunk,) = [entry for entry in entries if entry.opcode == Opcode.CHUNK]
        parts = chunk_parts(unpack_chunk(chunk.data, DecompressionBudget(1 << 20)))
        runs = [part for part in parts if isinstance(part, FixedRun)]
        assert [(run.channel, run.rows["log_time"].tolist()) for run in runs] == [(each, times) for each in channels]
