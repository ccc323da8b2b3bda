"""The container of a session, MCAP: its records as a table, parsed with a check of every declared length.

Source: mcap.dev, specification, "Records".
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import zstandard
from lz4.frame import LZ4FrameDecompressor

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")
LARGEST_RECORD: Final = 1 << 26
"""Bytes; chunks and attachments of a session are smaller."""
_LARGEST_CHUNK: Final = 1 << 24
_MOST_EXPANSION: Final = 100
"""Unpacked bytes per byte of file; a session at rest reaches about 40, a decompression bomb more."""
_FEWEST_PARTS: Final = 100_000
"""Allowed in any session; a log entry for every tick of a stop is a tenth of it."""
_BYTES_OF_A_PART: Final = 8
"""Bytes of file per part; ticks at rest, drained by tens, have 40."""
_TEXT_OF_A_PART: Final = 32
"""Bytes of text that count as another part."""
MESSAGE_HEAD: Final = 22
"""Bytes of a message before its data."""
_MESSAGE_BEGIN: Final = struct.Struct("<BQH")
"""Type, length and channel of a message."""
_NUMBERS: Final = struct.Struct("<HIQ")
"""Channel, sequence and log time of a message."""
BY_CHANNEL: Final = struct.Struct("<HQ")
"""Channel and number, or place, of its messages."""
_CHANNELS_AT: Final = 9 + 4 * 8 + 4
"""Bytes of a chunk's index before the places of its channels' messages."""
_SAME: Final = 11
"""Bytes of type, length and channel at the beginning of a message."""
_ONE_BY_ONE: Final = 24
"""Messages of a run compared one by one before numpy takes over; a recorder that drains often writes ten."""


class Opcode(IntEnum):
    """Types of records."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


LAYOUTS: Final[dict[int, str]] = {
    Opcode.HEADER: "ss",
    Opcode.FOOTER: "QQI",
    Opcode.SCHEMA: "Hssm",
    Opcode.CHANNEL: "HHssm",
    Opcode.CHUNK: "QQQIsb",
    Opcode.MESSAGE_INDEX: "Hm",
    Opcode.CHUNK_INDEX: "QQQQmQsQQ",
    Opcode.ATTACHMENT: "QQssbI",
    Opcode.ATTACHMENT_INDEX: "QQQQQss",
    Opcode.STATISTICS: "QHIIIIQQm",
    Opcode.METADATA: "sm",
    Opcode.METADATA_INDEX: "QQs",
    Opcode.SUMMARY_OFFSET: "BQQ",
    Opcode.DATA_END: "I",
}
"""Fields in order: an unsigned integer as in `struct`, s text, m and b bytes after their 4- or 8-byte length."""
_INTEGERS: Final = {code: struct.Struct(f"<{code}") for code in "BHIQ"}
_LENGTHS: Final = {"s": _INTEGERS["I"], "m": _INTEGERS["I"], "b": _INTEGERS["Q"]}


_KINDS: Final = {int(opcode): opcode.name.lower().replace("_", " ") for opcode in Opcode}


class DamagedError(Exception):
    """A record is not valid, or contradicts the file."""


class Entry(NamedTuple):
    """A complete record."""

    opcode: int
    at: int
    """Offset of its content in the file or chunk."""
    data: memoryview

    @property
    def start(self) -> int:
        """Offset of the record itself."""
        return self.at - HEAD.size

    @property
    def end(self) -> int:
        """Offset of what follows."""
        return self.at + len(self.data)


class FixedRun(NamedTuple):
    """Consecutive messages of one channel and one size in a chunk."""

    channel: int
    rows: npt.NDArray[np.void]
    """Columns `sequence`, `log_time` in ns and `data`; a view."""


class VariableRun(NamedTuple):
    """Consecutive messages of one channel, of any sizes, in a chunk."""

    channel: int
    number: int
    """Number of messages."""
    records: bytes
    """Records of the chunk, uncompressed."""
    start: int
    end: int
    """Offsets in the chunk."""

    def messages(self) -> Iterator[tuple[int, int, bytes]]:
        """Sequence, log time in ns and data of each message."""
        at = self.start
        while at < self.end:
            _, length = HEAD.unpack_from(self.records, at)
            at += HEAD.size
            _, sequence, log_time = _NUMBERS.unpack_from(self.records, at)
            yield sequence, log_time, self.records[at + MESSAGE_HEAD : at + length]
            at += length


class DecompressionBudget:
    """Limits of the unpacked bytes, and of the parts, of all chunks of a file.

    A part of a few packed bits becomes an object of some hundred bytes, and takes microseconds to make.
    """

    def __init__(self, file_bytes: int) -> None:
        self._bytes = _LARGEST_CHUNK + _MOST_EXPANSION * file_bytes
        self._parts = _FEWEST_PARTS + file_bytes // _BYTES_OF_A_PART

    def spend(self, size: int) -> None:
        """Use `size` bytes. Raises DamagedError if fewer are left."""
        if size > self._bytes:
            raise DamagedError("unpacks to more than a session of this size can hold")
        self._bytes -= size

    def part(self, number: int = 1, size: int = 0) -> None:
        """Use `number` parts with texts of `size` bytes. Raises DamagedError if fewer are left."""
        self._parts -= number + size // _TEXT_OF_A_PART
        if self._parts < 0:
            raise DamagedError("holds more records, events, parameters and texts than a session of this size can")


def kind(opcode: int) -> str:
    """Name of a type of record."""
    return _KINDS.get(opcode, f"record of type {opcode}")


def fields(opcode: int, data: memoryview, *, exact: bool = False) -> list[Any]:
    """Fields of a record as in `LAYOUTS`. Raises DamagedError, if `exact` also for bytes after them."""
    at, found = 0, list[Any]()
    try:
        for code in LAYOUTS[opcode]:
            layout = _LENGTHS.get(code) or _INTEGERS[code]
            (value,) = layout.unpack_from(data, at)
            at += layout.size
            if code in _LENGTHS:
                end = at + value
                if end > len(data):
                    raise DamagedError(f"{value} bytes leave the record")
                value, at = data[at:end], end
            found.append(str(value, "utf-8") if code == "s" else value)
    except (struct.error, UnicodeDecodeError) as error:
        raise DamagedError(str(error)) from error
    if exact and at != len(data):
        raise DamagedError(f"{len(data) - at} bytes too many")
    return found


def record(opcode: int, *values: Any) -> bytes:
    """A record with these fields, in the order of `LAYOUTS`."""
    parts = []
    for code, value in zip(LAYOUTS[opcode], values, strict=True):
        if code in _LENGTHS:
            data = value.encode() if code == "s" else value
            parts += [_LENGTHS[code].pack(len(data)), data]
        else:
            parts.append(_INTEGERS[code].pack(value))
    return HEAD.pack(opcode, sum(map(len, parts))) + b"".join(parts)


def text_map(data: memoryview, budget: DecompressionBudget | None = None) -> dict[str, str]:
    """Texts by name, as in metadata and channels. Raises DamagedError."""
    if budget is not None:
        budget.part(size=len(data))
    facts, at = {}, 0
    while at < len(data):
        key, at = _text(data, at)
        facts[key], at = _text(data, at)
    return facts


def _text(data: memoryview, at: int) -> tuple[str, int]:
    try:
        (length,) = _INTEGERS["I"].unpack_from(data, at)
        end = at + 4 + length
        if end > len(data):
            raise DamagedError(f"text of {length} bytes leaves its record")
        return str(data[at + 4 : end], "utf-8"), end
    except (struct.error, UnicodeDecodeError) as error:
        raise DamagedError(str(error)) from error


def attachment(data: memoryview) -> tuple[str, str, bytes]:
    """Name, media type and content of an attachment. Raises DamagedError if its checksum is wrong."""
    _, _, name, media_type, content, crc = fields(Opcode.ATTACHMENT, data, exact=True)
    if crc not in (0, zlib.crc32(data[:-4])):
        raise DamagedError(f"attachment {name!r} fails its checksum")
    return name, media_type, bytes(content)


def unpack_chunk(data: memoryview, budget: DecompressionBudget, *, checked: bool = False) -> bytes:
    """Unpack the records of a chunk. Raises DamagedError if it is not valid or, with `checked`, has no checksum."""
    _, _, size, crc, compression, packed = fields(Opcode.CHUNK, data, exact=True)
    if size > _LARGEST_CHUNK:
        raise DamagedError(f"claims {size} bytes, more than {_LARGEST_CHUNK}")
    budget.spend(size)
    if compression not in _UNPACK:
        raise DamagedError(f"is compressed with {compression!r}; this version reads zstd and lz4")
    raw = _UNPACK[compression](packed, size)
    if checked and not crc:
        raise DamagedError("has no checksum")
    if len(raw) != size or crc not in (0, zlib.crc32(raw)):
        raise DamagedError("fails its checksum")
    return raw


def _from_zstd(packed: memoryview, size: int) -> bytes:
    try:
        # zstandard trusts the size in the frame's header more than max_output_size
        if zstandard.frame_content_size(packed) not in (-1, size):
            raise DamagedError("contradicts its own size")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError as error:
        raise DamagedError(str(error)) from error


def _from_lz4(packed: memoryview, size: int) -> bytes:
    try:  # other programs write lz4, this one zstd
        raw: bytes = LZ4FrameDecompressor().decompress(bytes(packed), max_length=size + 1)
    except RuntimeError as error:
        raise DamagedError(str(error)) from error
    return raw


_UNPACK: Final[dict[str, Callable[[memoryview, int], bytes]]] = {
    "": lambda packed, _size: bytes(packed),
    "zstd": _from_zstd,
    "lz4": _from_lz4,
}
"""Unpackers by name of the compression; the output is at most slightly larger than the declared size."""


def chunk_parts(raw: bytes, variable_size: Collection[int] = ()) -> Iterator[Entry | FixedRun | VariableRun]:
    """Content of an unpacked chunk. Raises DamagedError at an incomplete record.

    Messages of one channel are in order; those of channels that take turns come channel by channel. Those of the
    channels `variable_size` come as `VariableRun`, and are not checked.
    """
    at = 0
    while at < len(raw):
        if at + HEAD.size > len(raw):
            raise DamagedError(f"has {len(raw) - at} bytes after its last record")
        opcode, length = HEAD.unpack_from(raw, at)
        at += HEAD.size
        if length > len(raw) - at:
            raise DamagedError(f"holds a record of {length} bytes, which leaves it")
        if opcode != Opcode.MESSAGE:
            yield Entry(opcode, at, memoryview(raw)[at : at + length])
            at += length
            continue
        if length < MESSAGE_HEAD:
            raise DamagedError(f"holds a message of {length} bytes, less than a message's head")
        (channel,) = _INTEGERS["H"].unpack_from(raw, at)
        if channel in variable_size:
            run = _variable_run(raw, at - HEAD.size, channel)
            yield run
            at = run.end
            continue
        runs, at = _fixed_runs(raw, at - HEAD.size, channel, variable_size)
        yield from runs


def _variable_run(raw: bytes, start: int, channel: int) -> VariableRun:
    """Messages from `start` to the first record that is not a complete message of the channel."""
    at, count, size, message, head = start, 0, len(raw), int(Opcode.MESSAGE), _MESSAGE_BEGIN.unpack_from
    while at + HEAD.size + MESSAGE_HEAD <= size:
        opcode, length, found = head(raw, at)
        end = at + HEAD.size + length
        if opcode != message or length < MESSAGE_HEAD or end > size or found != channel:
            break
        at, count = end, count + 1
    return VariableRun(channel, count, raw, start, at)


def chunk_index(summary: bytes) -> tuple[list[Entry], list[npt.NDArray[np.void]]]:
    """Other records of a summary, and its chunk indexes, alike ones in one array; raises DamagedError.

    Columns `first_ns`, `last_ns`, `start`, `size`, and `channels`, the channels' numbers of each chunk.
    """
    others, listed, at = list[Entry](), list[npt.NDArray[np.void]](), 0
    while at < len(summary):
        if at + HEAD.size > len(summary):
            raise DamagedError(f"the index has {len(summary) - at} bytes after its last record")
        opcode, length = HEAD.unpack_from(summary, at)
        end = at + HEAD.size + length
        if end > len(summary):
            raise DamagedError(f"the index holds a record of {length} bytes, which leaves it")
        if opcode != Opcode.CHUNK_INDEX:
            others.append(Entry(opcode, at + HEAD.size, memoryview(summary)[at + HEAD.size : end]))
            at = end
            continue
        rows = _alike_indexes(summary, at, end - at)
        listed.append(rows)
        at += (end - at) * len(rows)
    return others, listed


def _alike_indexes(summary: bytes, at: int, stride: int) -> npt.NDArray[np.void]:
    """Chunk indexes from `at` on that are as long as the first and have as many channels."""
    if stride < _CHANNELS_AT:
        raise DamagedError("the index of a chunk is too short")
    (room,) = _INTEGERS["I"].unpack_from(summary, at + _CHANNELS_AT - 4)
    if room % BY_CHANNEL.size or _CHANNELS_AT + room > stride:
        raise DamagedError("the index of a chunk is not valid")
    number = room // BY_CHANNEL.size
    count = _long_run(summary, at, stride, 1, (len(summary) - at) // stride, HEAD.size)
    columns: list[Any] = [
        ("head", f"V{HEAD.size}"),
        *((name, "<u8") for name in ("first_ns", "last_ns", "start", "size")),
    ]
    columns += [("room", "<u4"), ("channels", [("number", "<u2"), ("messages_at", "<u8")], (number,))]
    columns.append(("rest", f"V{stride - _CHANNELS_AT - room}"))
    rows: npt.NDArray[np.void] = np.ndarray(count, np.dtype(columns), summary, at)
    if (rows["room"] != room).any():
        raise DamagedError("the index of a chunk is not valid")
    return rows


def _fixed_runs(raw: bytes, at: int, channel: int, variable_size: Collection[int]) -> tuple[list[FixedRun], int]:
    """Messages of fixed sizes from `at` on, of one channel or of several that take turns, and where they end."""
    places = _turns(raw, at, channel, variable_size)
    stride = sum(HEAD.size + length for length, _ in places.values())
    most = (len(raw) - at) // stride
    count = min(_alike(raw, place, stride, most) for _, place in places.values())
    if count == 1:  # these are no turns
        places = {channel: places[channel]}
        stride = HEAD.size + places[channel][0]
    runs = [
        FixedRun(number, np.ndarray(count, message_dtype(size - MESSAGE_HEAD), raw, place, (stride,)))
        for number, (size, place) in places.items()
    ]
    return runs, at + count * stride


def _turns(raw: bytes, at: int, channel: int, variable_size: Collection[int]) -> dict[int, tuple[int, int]]:
    """Length and place of the next message of each channel until the turn of the first comes again, or of it alone."""
    _, length, number = _MESSAGE_BEGIN.unpack_from(raw, at)
    found, end = {channel: (length, at)}, at + HEAD.size + length
    while end + HEAD.size + MESSAGE_HEAD <= len(raw):
        opcode, length, number = _MESSAGE_BEGIN.unpack_from(raw, end)
        if number in found or number in variable_size or opcode != Opcode.MESSAGE or length < MESSAGE_HEAD:
            break
        if end + HEAD.size + length > len(raw):
            break
        found[number] = length, end
        end += HEAD.size + length
    return found if number == channel else {channel: found[channel]}


def _alike(raw: bytes, at: int, stride: int, most: int) -> int:
    """Number of messages from `at` on, one each `stride`, with the type, length and channel of the first."""
    head, count = raw[at : at + _SAME], 1
    while count < min(most, _ONE_BY_ONE) and raw[at + count * stride : at + count * stride + _SAME] == head:
        count += 1
    return _long_run(raw, at, stride, count, most) if count == _ONE_BY_ONE else count


def _long_run(raw: bytes, at: int, stride: int, count: int, most: int, same: int = _SAME) -> int:
    """Length of a run of `count` to `most` records that begin with the `same` bytes."""
    # the first eleven bytes of a message, type, length and channel, as two overlapping integers
    heads = [np.ndarray(most, "<u8", raw, at + skip, (stride,)) for skip in (0, same - 8)]
    ahead = _ONE_BY_ONE
    while count < most:
        others = np.logical_or.reduce([head[count : count + ahead] != head[0] for head in heads])
        if others.any():
            return count + int(others.argmax())
        count, ahead = min(count + ahead, most), 16 * ahead
    return count


@lru_cache(maxsize=64)
def message_dtype(size: int) -> np.dtype[np.void]:
    """Numpy type of a message record with `size` bytes of data."""
    heads = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")]
    return np.dtype([*heads, ("log_time", "<u8"), ("publish_time", "<u8"), ("data", f"V{size}")])
