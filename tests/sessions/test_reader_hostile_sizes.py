"""Files that claim far more than they hold."""

import struct
import tracemalloc
import zlib

import lz4.frame
import pytest
import zstandard

from inteco_abs.errors import SessionError
from inteco_abs.format.io_frame import IO_TOPIC, Direction, IoFrame, pack_io_frame
from inteco_abs.sessions import read_frames, read_session

CHUNK, METADATA, ATTACHMENT, SCHEMA, CHANNEL, MESSAGE = 6, 12, 9, 3, 4, 5
MOST_BYTES = 4_000_000
U32, U64 = (1 << 32) - 1, (1 << 64) - 1
LENGTHS = [1 << 32, 1 << 60, (1 << 63) - 1, 1 << 63, U64]


def read_within(path, most_bytes):
    """The session; reading may take only so much memory."""
    tracemalloc.start()
    try:
        return read_session(path)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < most_bytes


@pytest.fixture
def refuse(altered):
    """Reads a file that must be refused, and must not cost memory; gives the message."""

    def check(data):
        with pytest.raises(SessionError) as refusal:
            read_within(altered(data), MOST_BYTES)
        return str(refusal.value)

    return check


def zstd_frame_of(declared: int) -> bytes:
    """A frame whose header declares that size, with one small block."""
    single_segment_and_8_byte_size = 0xE0
    last_raw_block = (5 << 3 | 1).to_bytes(3, "little")
    return (
        b"\x28\xb5\x2f\xfd" + struct.pack("<BQ", single_segment_and_8_byte_size, declared) + last_raw_block + b"hello"
    )


def test_the_crafted_frame_is_a_frame():
    assert zstandard.frame_content_size(zstd_frame_of(1 << 50)) == 1 << 50
    assert zstandard.decompress(zstd_frame_of(5)) == b"hello"


@pytest.mark.parametrize("compression", ["", "zstd"])
@pytest.mark.parametrize("size", [1 << 32, 1 << 60, U64])
def test_a_chunk_that_claims_to_unpack_to_more_than_any_session_has(container, refuse, compression, size):
    packed = zstandard.compress(b"small") if compression else b"small"
    message = refuse(container.craft(container.chunk(packed, size, compression)))
    assert f"claims {size} bytes" in message


@pytest.mark.parametrize("declared", [1 << 28, 1 << 40, 1 << 60, U64 - 2])
def test_a_frame_that_declares_another_size_than_its_chunk(container, refuse, declared):
    message = refuse(container.craft(container.chunk(zstd_frame_of(declared), 5, "zstd")))
    assert "contradicts its own size" in message


def test_a_frame_that_unpacks_to_more_than_its_chunk_says(container, refuse):
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(64_000_000))
    assert len(bomb) < 10_000
    assert "is damaged" in refuse(container.craft(container.chunk(bomb, 1000, "zstd")))


@pytest.mark.parametrize(
    "packed", [lz4.frame.compress(bytes(12_000_000)), lz4.frame.compress(b"small"), b"no frame", b""]
)
def test_an_lz4_frame_that_is_not_what_its_chunk_says(container, refuse, packed):
    assert len(packed) < 100_000
    assert "is damaged" in refuse(container.craft(container.chunk(packed, 1000, "lz4")))


def test_a_frame_that_unpacks_to_less_than_its_chunk_says(container, refuse):
    packed = zstandard.ZstdCompressor(write_content_size=False).compress(b"small")
    assert "is damaged" in refuse(container.craft(container.chunk(packed, 1000, "zstd")))


@pytest.mark.parametrize("size", [0, 4, 6, 1000])
def test_a_chunk_without_compression_of_another_size_than_it_says(container, refuse, size):
    assert "is damaged" in refuse(container.craft(container.chunk(b"small", size, "")))


def test_a_chunk_that_is_not_a_frame(container, refuse):
    assert "is damaged" in refuse(container.craft(container.chunk(b"no frame", 8, "zstd")))


@pytest.mark.parametrize("length", [10, *LENGTHS])
def test_a_chunk_whose_records_claim_to_be_longer_than_it(container, refuse, length):
    chunk = struct.pack("<QQQI", 0, 0, 5, 0) + container.text("") + struct.pack("<Q", length) + b"small"
    refuse(container.craft(container.record(CHUNK, chunk)))


@pytest.mark.parametrize("length", [5, U32])
def test_a_compression_name_longer_than_its_chunk(container, refuse, length):
    chunk = struct.pack("<QQQII", 0, 0, 5, 0, length) + b"zstd"
    assert "is damaged" in refuse(container.craft(container.record(CHUNK, chunk)))


@pytest.mark.parametrize("length", LENGTHS)
def test_a_record_that_claims_to_leave_the_file_is_where_the_file_ends(container, altered, tiny, length):
    records = container.split(tiny.path.read_bytes())
    first = records[: next(at for at, record in enumerate(records) if record.opcode == CHUNK) + 1]
    data = container.magic + b"".join(map(bytes, first)) + struct.pack("<BQ", METADATA, length) + bytes(100)
    session = read_within(altered(data), MOST_BYTES)
    assert session.incomplete
    assert len(session.ticks) == 0
    assert session.attachments["config.toml"] == tiny.session.attachments["config.toml"]


@pytest.mark.parametrize("length", LENGTHS)
def test_an_attachment_beyond_its_record_is_damage(container, refuse, length):
    content = bytes(16) + container.text("config.toml") + container.text("application/toml") + struct.pack("<Q", length)
    refuse(container.craft(container.record(ATTACHMENT, content + b"profile = 1" + bytes(4))))


@pytest.mark.parametrize("length", [20, U32])
@pytest.mark.parametrize(
    ("opcode", "before"),
    [
        (METADATA, b""),
        (METADATA, b"\x01\0\0\0a"),
        (METADATA, b"\x01\0\0\0a\x08\0\0\0"),
        (SCHEMA, b"\x01\0"),
        (CHANNEL, b"\x01\0\x01\0"),
        (CHANNEL, b"\x01\0\x01\0\x01\0\0\0a"),
        (ATTACHMENT, bytes(16)),
    ],
    ids=["name", "map", "key", "schema", "topic", "encoding", "attachment"],
)
def test_a_text_or_map_beyond_its_record_is_damage(container, refuse, opcode, before, length):
    content = before + struct.pack("<I", length) + b"abcd"
    assert "is damaged" in refuse(container.craft(container.record(opcode, content)))


@pytest.mark.parametrize("opcode", [SCHEMA, CHANNEL, MESSAGE, CHUNK, ATTACHMENT, METADATA])
@pytest.mark.parametrize("size", [0, 1, 3])
def test_a_record_too_short_for_its_kind(container, refuse, opcode, size):
    assert "is damaged" in refuse(container.craft(container.record(opcode, bytes(size))))


def test_text_that_is_not_utf_8(container, refuse):
    content = struct.pack("<I", 2) + b"\xff\xfe" + struct.pack("<I", 0)
    assert "is damaged" in refuse(container.craft(container.record(METADATA, content)))


class TestManySmallParts:
    """A few packed bits each, and an object of some hundred bytes once they are read."""

    LOG, PARAMETERS = 2, 3

    @staticmethod
    def message(container, channel, data):
        return bytes(container.record(MESSAGE, struct.pack("<HIQQ", channel, 0, 1, 1) + data))

    @pytest.fixture
    def swollen(self, container, short, altered):
        """Path of a session of which a further chunk holds so many of one part."""

        def write(part, number, before=b""):
            records = container.split(short.read_bytes())
            first = next(at for at, record in enumerate(records) if record.opcode == CHUNK)
            raw = before + part * number
            chunk = container.chunk(zstandard.compress(raw), len(raw), "zstd", zlib.crc32(raw))
            return altered(container.join([*records[: first + 1], chunk, *records[first + 1 :]]))

        return write

    @pytest.fixture
    def parts(self, container):
        event = self.message(container, self.LOG, b"\x10\x02\x1a\x01a")
        values = self.message(container, self.PARAMETERS, b"\x15\0\0\0\0")
        facts = container.text("") + container.text("")
        return {
            "events": event,
            "parameters": values,
            "messages of two channels in turn": event + values,
            "metadata": bytes(container.record(METADATA, container.text("x") + struct.pack("<I", len(facts)) + facts)),
            "records of no known type": bytes(container.record(200, b"")),
        }

    KINDS = ("events", "parameters", "messages of two channels in turn", "metadata", "records of no known type")

    @pytest.mark.parametrize("kind", KINDS)
    def test_more_than_any_session_has_are_refused_before_they_cost_memory(
        self, swollen, short, parts, kind, verb, tmp_path
    ):
        path = swollen(parts[kind], 120_000)
        assert path.stat().st_size - short.stat().st_size < 20_000
        with pytest.raises(SessionError, match=r"is damaged: chunk at byte .* more .* than a session of this size can"):
            read_session(path)
        done = verb("validate", path)
        assert done.code == 1
        assert "texts than a session of this size can" in done.out
        saved = verb("recover", path, "--out", tmp_path / "again.mcap")
        assert "60 ticks recovered" in saved.out or "texts than a session of this size can" in saved.err

    @pytest.mark.parametrize("kind", KINDS[:2])
    def test_a_long_run_with_many_faults_is_read(self, swollen, parts, kind):
        session = read_session(swollen(parts[kind], 40_000))
        assert len(session.ticks) == 60
        assert max(len(session.log), len(session.parameters)) > 40_000

    @pytest.fixture
    def with_frames(self, container, swollen):
        """Path of a session with so many raw frames."""
        facts = {"board": "usb2", "recorded_by": "", "clock": "monotonic", "start_ns": "0"}
        texts = b"".join(container.text(text) for pair in facts.items() for text in pair)
        channel = struct.pack("<HH", 9, 0) + container.text(IO_TOPIC) + container.text("protobuf")
        declared = bytes(container.record(CHANNEL, channel + struct.pack("<I", len(texts)) + texts))
        frame = self.message(container, 9, pack_io_frame(IoFrame(1, Direction.OUT)))
        return lambda number: swollen(frame, number, declared)

    def test_more_raw_frames_than_any_session_has_are_refused_before_they_cost_memory(self, with_frames, short):
        path = with_frames(120_000)
        assert path.stat().st_size - short.stat().st_size < 20_000
        with pytest.raises(SessionError, match=r"is damaged: holds more records.* than a session of this size can"):
            read_frames(path)

    def test_the_raw_frames_of_a_long_run_are_read(self, with_frames):
        assert len(read_frames(with_frames(40_000)).records) == 40_000
