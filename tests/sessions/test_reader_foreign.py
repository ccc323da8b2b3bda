import gzip
import json

import lz4.frame
import pytest
from mcap.writer import CompressionType, Writer

from inteco_abs.analysis import replay_session
from inteco_abs.control import CONTROLLERS, build_pipeline, control_check
from inteco_abs.errors import SessionError
from inteco_abs.sessions import TICK, read_session, session_config, validate

CHUNK, DATA_END = 6, 15


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is not an MCAP file, it is empty"),
        (b"\n", "is not an MCAP file"),
        (b"time;slip\n0.0;0.2\n", "is not an MCAP file, it starts with b'time;sli'"),
        (gzip.compress(b"\x89MCAP0\r\n" * 100), "is not an MCAP file"),
        (b"\x89MCAP1\r\n" + bytes(100), "is not an MCAP file"),
        (b"\x89MCAP0\r", "is not an MCAP file"),
    ],
    ids=["empty", "newline", "text", "gzip", "later version", "cut magic"],
)
def test_a_file_of_another_kind_is_refused_and_named(altered, data, words):
    path = altered(data)
    with pytest.raises(SessionError) as refusal:
        read_session(path)
    assert str(refusal.value).startswith(f"{path}: {words}")


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(SessionError, match=f"{tmp_path}: cannot be read: it is not a regular file"):
        read_session(tmp_path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(SessionError, match=r"nothing\.mcap: cannot be read: No such file"):
        read_session(tmp_path / "nothing.mcap")


def write_foreign(path, topic, *, finish=True, name="Frame", encoding="jsonschema", descriptor=b"{}", data=b"{}"):
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema(name, encoding, descriptor)
        channel = writer.register_channel(topic, "json" if encoding == "jsonschema" else "protobuf", schema)
        for time_ns in range(50):
            writer.add_message(channel, time_ns, data, time_ns)
        writer.flush()
        if finish:
            writer.add_metadata("camera", {"lens": "f/2"})
            writer.finish()
    return path


def test_an_mcap_file_of_another_program_is_refused(tmp_path):
    path = write_foreign(tmp_path / "camera.mcap", "/camera")
    with pytest.raises(SessionError, match="is an MCAP file, but not a session of this program"):
        read_session(path)


def test_a_cut_mcap_file_of_another_program_is_refused(tmp_path):
    path = write_foreign(tmp_path / "camera.mcap", "/camera", finish=False)
    with pytest.raises(SessionError, match="not a session of this program"):
        read_session(path)


@pytest.mark.parametrize("finish", [True, False], ids=["whole", "cut"])
def test_our_topic_with_another_encoding_is_refused(tmp_path, finish):
    path = write_foreign(tmp_path / "stop.mcap", TICK.topic, finish=finish, data=json.dumps({"slip": 0.2}).encode())
    with pytest.raises(SessionError, match=r"/abs/tick has another layout than inteco_abs\.v1\.Tick"):
        read_session(path)


def test_our_name_with_another_schema_is_refused(tmp_path):
    path = write_foreign(
        tmp_path / "stop.mcap", TICK.topic, name=TICK.name, encoding="protobuf", descriptor=b"\n\x00", data=b""
    )
    with pytest.raises(SessionError, match="another layout"):
        read_session(path)


@pytest.mark.parametrize("data", [b"", bytes(TICK.size), bytes(TICK.size - 1), b"\x0a" * TICK.size])
def test_a_tick_with_another_layout_under_our_schema_is_refused(tmp_path, data):
    path = write_foreign(
        tmp_path / "stop.mcap",
        TICK.topic,
        name=TICK.name,
        encoding="protobuf",
        descriptor=TICK.descriptor(),
        data=data,
    )
    with pytest.raises(SessionError, match="does not match the"):
        read_session(path)


def test_records_of_an_unknown_kind_are_skipped(container, altered, tiny):
    records = []
    for record in container.split(tiny.path.read_bytes()):
        unknown = [container.record(opcode, b"from a later version") for opcode in (16, 0x80, 255)]
        records += [*unknown, record] if record.opcode <= DATA_END else [record]
    session = read_session(altered(container.join(records)))
    assert session.incomplete == ""
    assert session.payload == tiny.session.payload
    assert (session.metadata, session.attachments) == (tiny.session.metadata, tiny.session.attachments)


def test_records_of_an_unknown_kind_in_a_chunk_are_skipped(container, altered, tiny):
    records = []
    for record in container.split(tiny.path.read_bytes()):
        if record.opcode != CHUNK:
            records.append(record)
            continue
        inner = container.split(container.unpack(record), 0)
        raw = b"".join(bytes(container.record(200, b"later")) + bytes(entry) for entry in inner)
        records.append(container.chunk(raw, len(raw), ""))
    session = read_session(altered(container.join(records)))
    assert session.incomplete == ""
    assert session.payload == tiny.session.payload


@pytest.mark.parametrize("compression", ["lzma", "br", "ZSTD"])
def test_an_unknown_compression_is_named(container, altered, tiny, compression):
    records = [
        container.chunk(container.unpack(record), len(container.unpack(record)), compression)
        if record.opcode == CHUNK
        else record
        for record in container.split(tiny.path.read_bytes())
    ]
    with pytest.raises(SessionError, match=f"is compressed with '{compression}'"):
        read_session(altered(container.join(records)))


@pytest.mark.parametrize(("compression", "packed"), [("", bytes), ("lz4", lz4.frame.compress)], ids=["none", "lz4"])
def test_chunks_that_were_compressed_again_are_read(container, altered, tiny, compression, packed):
    records = [
        container.chunk(packed(container.unpack(record)), len(container.unpack(record)), compression)
        if record.opcode == CHUNK
        else record
        for record in container.split(tiny.path.read_bytes())
    ]
    session = read_session(altered(container.join(records)))
    assert (session.incomplete, session.payload) == ("", tiny.session.payload)


def test_a_message_of_an_unknown_channel_is_damage(container, altered):
    message = container.record(5, (9).to_bytes(2, "little") + bytes(20) + b"data")
    with pytest.raises(SessionError, match="is damaged"):
        read_session(altered(container.craft(message)))


@pytest.fixture
def encoded_again(officially, tiny, tmp_path):
    """The tiny session as a program writes it that decodes messages and encodes them: zeros are left out."""

    def write(*, finish=True):
        official, path = officially(tiny.path), tmp_path / "again.mcap"
        with path.open("wb") as file:
            writer = Writer(file, compression=CompressionType.ZSTD)
            writer.start(library="another program")
            schemas, channels = {}, {}
            for schema, channel, message, decoded in official.messages:
                if channel.id not in channels:
                    schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(
                        channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                    )
                data = decoded.SerializeToString(deterministic=True)
                writer.add_message(channels[channel.id], message.log_time, data, message.log_time, message.sequence)
            for each in official.attachments:
                writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
            for each in official.metadata:
                writer.add_metadata(each.name, dict(each.metadata))
            writer.flush()
            if finish:
                writer.finish()
        return path

    return write


def test_a_session_that_was_encoded_again_is_read_as_it_was_recorded(encoded_again, tiny):
    path = encoded_again()
    session = read_session(path)
    assert session.payload == tiny.session.payload
    assert session.truth.tobytes() == tiny.session.truth.tobytes()
    assert validate(path).verdict == "well"
    config = session_config(session, (control_check(CONTROLLERS),))
    assert replay_session(session, build_pipeline(config, CONTROLLERS)).differing == 0


def test_without_its_end_it_is_read_too(encoded_again, tiny):
    session = read_session(encoded_again(finish=False))
    assert session.incomplete
    assert session.payload == tiny.session.payload


@pytest.mark.parametrize("change", ["twice", "unknown field", "another wire type", "cut", "empty"])
def test_a_foreign_message_is_not_encoded_again(tiny, change):
    message = bytes(tiny.session.payload[: TICK.size])
    changed = {
        "twice": message + message[:9],
        "unknown field": message + b"\xf8\x07\x01",
        "another wire type": b"\x0a\x08" + message[1:],
        "cut": message[:-1],
        "empty": b"",
    }[change]
    with pytest.raises(ValueError, match=r"field|integer|is not valid"):
        TICK.repacked(changed)
    assert TICK.repacked(message) == message
