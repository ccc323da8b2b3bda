"""Writes the container of a session, MCAP: messages in compressed chunks, and the index at its end.

Source: mcap.dev, specification, "Records".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping
from io import BytesIO
from typing import BinaryIO, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt
import zstandard

from inteco_abs.sessions.container import (
    BY_CHANNEL,
    HEAD,
    MAGIC,
    MESSAGE_HEAD,
    Entry,
    Opcode,
    fields,
    message_dtype,
    record,
)

_MESSAGE: Final = struct.Struct("<BQHIQQ")
"""A message before its data: type, length, channel, sequence, log and publish time."""
_ENTRY: Final = struct.Struct("<QQ")
_COMPRESSION: Final = "zstd"
_NEVER: Final = (1 << 64, 0)
"""First and last time of no message."""
_GROUPS: Final = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
)
"""Types of records in the summary, in order."""


class Messages(NamedTuple):
    """Messages of one channel and one size."""

    channel: int
    first: int
    """Sequence number of the first."""
    times_ns: npt.NDArray[np.uint64]
    """UNIX times."""
    data: npt.NDArray[np.void]


class McapWriter:
    """Writes an MCAP file to `file`. A chunk ends with the message that makes it larger than `chunk_bytes`."""

    def __init__(self, file: BinaryIO, library: str, chunk_bytes: int = 1 << 20) -> None:
        self._file = file
        self._chunk_bytes = chunk_bytes
        self._compressor = zstandard.ZstdCompressor()
        self._at = self._crc = 0
        self._chunk = bytearray()
        self._indices: dict[int, bytearray] = {}
        """Time and place in the chunk of each message, by channel."""
        self._span_ns = _NEVER
        self._whole_span_ns = _NEVER
        self._numbers = dict.fromkeys(Opcode, 0)
        """Number of records by type."""
        self._messages: dict[int, int] = {}
        """Number of messages by channel."""
        # packed, a chunk's index takes a tenth of an object's memory; a thousand stops have 80 000
        self._summary = {group: bytearray() for group in _GROUPS}
        self._write(MAGIC)
        self._write(record(Opcode.HEADER, "", library))

    @classmethod
    def continued(cls, file: BinaryIO, at: int, crc: int, summary: Iterable[Entry]) -> Self:
        """A writer that goes on at `at`, before the end of the data of a complete file with this `summary`.

        `crc` is the checksum of the file up to there. Raises DamagedError.
        """
        writer = cls(BytesIO(), "")
        writer._file, writer._at, writer._crc = file, at, crc
        for entry in summary:
            if entry.opcode == Opcode.STATISTICS:
                *_, first_ns, last_ns, messages = fields(entry.opcode, entry.data)
                writer._messages = dict(BY_CHANNEL.iter_unpack(messages))
                writer._whole_span_ns = (first_ns, last_ns) if writer._messages else _NEVER
            elif entry.opcode in _GROUPS:
                writer._numbers[Opcode(entry.opcode)] += 1
                writer._summary[Opcode(entry.opcode)] += HEAD.pack(entry.opcode, len(entry.data)) + entry.data
        return writer

    def add_schema(self, name: str, descriptor: bytes) -> int:
        """Declare a protobuf schema by its file descriptor set; return its number."""
        number = self._numbers[Opcode.SCHEMA] + 1
        self._declare(Opcode.SCHEMA, record(Opcode.SCHEMA, number, name, "protobuf", descriptor))
        return number

    def add_channel(self, topic: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Declare a channel of messages; return its number."""
        number = self._numbers[Opcode.CHANNEL] + 1
        self._declare(Opcode.CHANNEL, record(Opcode.CHANNEL, number, schema, topic, "protobuf", _packed(metadata)))
        return number

    def add_message(self, channel: int, unix_ns: int, data: bytes, sequence: int = 0) -> None:
        """Add one message."""
        entry = _ENTRY.pack(unix_ns, len(self._chunk))
        head = _MESSAGE.pack(Opcode.MESSAGE, MESSAGE_HEAD + len(data), channel, sequence, unix_ns, unix_ns)
        self._index(channel, entry, (unix_ns, unix_ns))
        self._chunk += head + data
        self._end_full_chunk()

    def add_messages(self, *streams: Messages) -> None:
        """Add messages in turns: of each of the `streams`, which are as long as each other, one after the other."""
        columns = [(f"{at}", message_dtype(stream.data.itemsize)) for at, stream in enumerate(streams)]
        turns = np.empty(len(streams[0].data), columns)
        for (name, _), stream in zip(columns, streams, strict=True):
            rows = turns[name]
            rows["opcode"], rows["channel"] = Opcode.MESSAGE, stream.channel
            rows["length"] = MESSAGE_HEAD + stream.data.itemsize
            rows["sequence"] = np.arange(stream.first, stream.first + len(rows)) & 0xFFFFFFFF
            rows["log_time"] = rows["publish_time"] = stream.times_ns
            rows["data"] = stream.data
        size = turns.itemsize
        while len(turns):
            fit = max((self._chunk_bytes - len(self._chunk)) // size + 1, 1)
            part, turns = turns[:fit], turns[fit:]
            at = len(self._chunk) + size * np.arange(len(part))
            for (name, of), stream in zip(columns, streams, strict=True):
                entries = np.empty((len(part), 2), "<u8")
                entries[:, 0], entries[:, 1] = part[name]["log_time"], at
                self._index(stream.channel, entries.tobytes(), (int(entries[:, 0].min()), int(entries[:, 0].max())))
                at += of.itemsize
            self._chunk += part.tobytes()
            self._end_full_chunk()

    def add_metadata(self, name: str, facts: Mapping[str, str]) -> None:
        """Add a metadata record, in front of the unfinished chunk."""
        at, data = self._at, record(Opcode.METADATA, name, _packed(facts))
        self._write(data)
        self._list(Opcode.METADATA_INDEX, at, len(data), name)

    def add_attachment(self, unix_ns: int, name: str, media_type: str, content: bytes) -> None:
        """Add an attachment, in front of the unfinished chunk."""
        at, data = self._at, record(Opcode.ATTACHMENT, unix_ns, unix_ns, name, media_type, content, 0)
        self._write(data[:-4] + struct.pack("<I", zlib.crc32(memoryview(data)[9:-4])))
        self._list(Opcode.ATTACHMENT_INDEX, at, len(data), unix_ns, unix_ns, len(content), name, media_type)

    def end_chunk(self) -> None:
        """Write the chunk with its index, if it has a message."""
        if not self._indices:
            return
        at, packed = self._at, self._compressor.compress(self._chunk)
        size, (first_ns, last_ns) = len(self._chunk), self._span_ns
        self._write(record(Opcode.CHUNK, first_ns, last_ns, size, zlib.crc32(self._chunk), _COMPRESSION, packed))
        end, offsets = self._at, b""
        for channel, entries in self._indices.items():
            offsets += BY_CHANNEL.pack(channel, self._at)
            self._write(record(Opcode.MESSAGE_INDEX, channel, entries))
        places = at, end - at, offsets, self._at - end
        self._list(Opcode.CHUNK_INDEX, first_ns, last_ns, *places, _COMPRESSION, len(packed), size)
        self._chunk, self._indices, self._span_ns = bytearray(), {}, _NEVER

    def finish(self) -> None:
        """Write the last chunk, the index and the end; the file stays open."""
        self.end_chunk()
        self._write(record(Opcode.DATA_END, self._crc))
        start, offsets = self._at, b""
        self._list_statistics()
        for group, records in self._summary.items():
            offsets += record(Opcode.SUMMARY_OFFSET, group, self._at, len(records))
            self._write(records)
        summary = b"".join(self._summary.values()) + offsets
        footer = record(Opcode.FOOTER, start, self._at, 0)[:-4]
        self._write(offsets + footer + struct.pack("<I", zlib.crc32(footer, zlib.crc32(summary))) + MAGIC)

    def _list_statistics(self) -> None:
        numbers = (
            self._numbers[kind]
            for kind in (
                Opcode.SCHEMA,
                Opcode.CHANNEL,
                Opcode.ATTACHMENT_INDEX,
                Opcode.METADATA_INDEX,
                Opcode.CHUNK_INDEX,
            )
        )
        span_ns = self._whole_span_ns if self._messages else (0, 0)
        messages = b"".join(BY_CHANNEL.pack(*each) for each in self._messages.items())
        self._list(Opcode.STATISTICS, sum(self._messages.values()), *numbers, *span_ns, messages)

    def _index(self, channel: int, entries: bytes, span_ns: tuple[int, int]) -> None:
        """Note messages that follow in the chunk."""
        self._indices.setdefault(channel, bytearray()).extend(entries)
        self._messages[channel] = self._messages.get(channel, 0) + len(entries) // _ENTRY.size
        self._span_ns, self._whole_span_ns = _joined(self._span_ns, span_ns), _joined(self._whole_span_ns, span_ns)

    def _declare(self, kind: Opcode, data: bytes) -> None:
        """Add a schema or channel to the chunk and the summary."""
        self._chunk += data
        self._numbers[kind] += 1
        self._summary[kind] += data
        self._end_full_chunk()

    def _end_full_chunk(self) -> None:
        if len(self._chunk) > self._chunk_bytes:
            self.end_chunk()

    def _list(self, kind: Opcode, *values: object) -> None:
        self._numbers[kind] += 1
        self._summary[kind] += record(kind, *values)

    def _write(self, data: bytes | bytearray) -> None:
        self._file.write(data)
        self._crc = zlib.crc32(data, self._crc)
        self._at += len(data)


def _joined(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    return min(one[0], other[0]), max(one[1], other[1])


def _packed(facts: Mapping[str, str]) -> bytes:
    """Texts by name, as in metadata and channels."""
    texts = [text.encode() for item in facts.items() for text in item]
    return b"".join(struct.pack("<I", len(text)) + text for text in texts)
