"""The container as it is written: byte for byte what the reference writer makes of the same messages."""

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from inteco_abs.sessions.mcap_writer import McapWriter

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
                writer.add_messages(channels[at], 2**32 - 3, np.array(times, np.uint64), data)
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
