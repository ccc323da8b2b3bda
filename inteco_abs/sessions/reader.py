"""Reads a session into numpy arrays. Declared lengths are checked against the file before they are believed."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
import zstandard

from inteco_abs.errors import SessionError
from inteco_abs.records.schema import LOG_TOPIC, TICK, TRUTH, Message

_MAGIC: Final = b"\x89MCAP0\r\n"
_LIBRARY: Final = "inteco-abs/"
_HEADER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _ATTACHMENT, _METADATA, _DATA_END = 1, 3, 4, 5, 6, 9, 12, 15
_LARGEST_CHUNK: Final = 1 << 24
_MOST_EXPANSION: Final = 100
"""Bytes unpacked per byte of file; ticks of a wheel at rest reach about 40. More is a bomb, not a session."""
_MALFORMED: Final = (struct.error, UnicodeDecodeError, IndexError, KeyError, OverflowError)
"""What taking a record apart raises when its own lengths and numbers do not fit."""
_HEAD: Final = struct.Struct("<BQ")
_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")


@dataclass(frozen=True, slots=True)
class Session:
    """What a session file holds. Arrays have one row per tick; columns and units as in `schema.TICK`."""

    path: Path
    ticks: npt.NDArray[np.void]
    payload: bytes
    """The ticks as they are in the file, back to back."""
    truth: npt.NDArray[np.void]
    """One row per tick on a simulated board, no rows on a real one; columns as in `schema.TRUTH`."""
    metadata: dict[str, dict[str, str]]
    """By record name without `inteco_abs.`; records of one name are merged, the later one wins."""
    attachments: dict[str, bytes]
    channels: dict[str, dict[str, str]]
    """Metadata of each channel, by topic."""
    events: int
    incomplete: str
    """Empty for a whole file, else where it ends."""


class _DamagedError(Exception):
    """A record contradicts itself."""


class _Entry(NamedTuple):
    opcode: int
    at: int
    """Offset of the record's content in the file or chunk."""
    data: memoryview


@dataclass(slots=True)
class _Content:
    library: str = _LIBRARY
    """Program that wrote the file; assumed ours until the header says otherwise."""
    schemas: dict[int, tuple[str, bytes]] = field(default_factory=dict)
    channels: dict[int, tuple[str, int]] = field(default_factory=dict)
    channel_facts: dict[str, dict[str, str]] = field(default_factory=dict)
    messages: dict[str, list[bytes]] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)


def read_session(path: Path) -> Session:
    """The session at `path`. A file that was cut is read up to its last whole record and says so in `incomplete`.

    Raises SessionError if the file cannot be opened, is no session, or is damaged.
    """
    try:
        if path.exists() and not path.is_file():
            raise SessionError(f"{path}: cannot be read: it is no regular file")
        with path.open("rb") as file:
            head = file.read(len(_MAGIC))
            data = head + file.read() if head == _MAGIC else head
    except OSError as error:
        raise SessionError(f"{path}: cannot be read: {error.strerror}") from error
    if not data.startswith(_MAGIC):
        kind = f"starts with {data!r}" if data else "is empty"
        raise SessionError(f"{path}: is no MCAP file, it {kind}")
    content = _Content()
    try:
        incomplete = _read_records(memoryview(data), content)
        return _assemble(path, content, incomplete)
    except _DamagedError as error:
        raise SessionError(f"{path}: is damaged: {error}") from error


def _read_records(data: memoryview, content: _Content) -> str:
    checked = False
    budget = _LARGEST_CHUNK + _MOST_EXPANSION * len(data)
    for entry in _records(data, len(_MAGIC)):
        if entry.opcode == _DATA_END:
            _check_data(data, entry)
            checked = True
            break
        if entry.opcode == _CHUNK:
            unpacked = _unpack_chunk(entry)
            budget -= len(unpacked)
            if budget < 0:
                raise _DamagedError(f"chunk at byte {entry.at} unpacks to more than a session of this size can hold")
            for inner in _records(memoryview(unpacked), 0):
                _take(inner, content)
        else:
            _take(entry, content)
    if checked and bytes(data[-len(_MAGIC) :]) == _MAGIC:
        return ""
    return f"the file ends early, after {len(data)} bytes, without its index"


def _records(data: memoryview, at: int) -> Iterator[_Entry]:
    """Whole records from offset `at`; stops where the next one is not all there."""
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > len(data) - at:
            return
        yield _Entry(opcode, at, data[at : at + length])
        at += length


def _take(entry: _Entry, content: _Content) -> None:
    if not entry.opcode:
        raise _DamagedError(f"record at byte {entry.at} has no type")
    try:
        _TAKERS.get(entry.opcode, _ignore)(entry.data, content)
    except _MALFORMED as error:
        raise _DamagedError(f"record of type {entry.opcode} at byte {entry.at}: {error}") from error


def _ignore(data: memoryview, content: _Content) -> None:
    """Records that repeat what is known, or that a later version added."""


def _take_header(data: memoryview, content: _Content) -> None:
    _, at = _text(data, 0)
    content.library, _ = _text(data, at)


def _take_schema(data: memoryview, content: _Content) -> None:
    (number,) = struct.unpack_from("<H", data)
    name, at = _text(data, 2)
    _, at = _text(data, at)
    (length,) = struct.unpack_from("<I", data, at)
    content.schemas[number] = name, bytes(data[at + 4 : at + 4 + length])


def _take_channel(data: memoryview, content: _Content) -> None:
    number, schema = struct.unpack_from("<HH", data)
    topic, at = _text(data, 4)
    _, at = _text(data, at)
    content.channels[number] = topic, schema
    content.channel_facts[topic] = _map(data, at)


def _take_message(data: memoryview, content: _Content) -> None:
    number, _, _, _ = _MESSAGE_HEAD.unpack_from(data)
    topic, _ = content.channels[number]
    content.messages.setdefault(topic, []).append(bytes(data[_MESSAGE_HEAD.size :]))


def _take_metadata(data: memoryview, content: _Content) -> None:
    name, at = _text(data, 0)
    content.metadata.setdefault(name.removeprefix("inteco_abs."), {}).update(_map(data, at))


def _take_attachment(data: memoryview, content: _Content) -> None:
    name, at = _text(data, 16)
    _, at = _text(data, at)
    (length,) = struct.unpack_from("<Q", data, at)
    end = at + 8 + length
    (crc,) = struct.unpack_from("<I", data, end)
    if crc not in (0, zlib.crc32(data[:end])):
        raise _DamagedError(f"attachment {name!r} fails its checksum")
    content.attachments[name] = bytes(data[at + 8 : end])


_TAKERS: Final = {
    _HEADER: _take_header,
    _SCHEMA: _take_schema,
    _CHANNEL: _take_channel,
    _MESSAGE: _take_message,
    _METADATA: _take_metadata,
    _ATTACHMENT: _take_attachment,
}


def _unpack_chunk(entry: _Entry) -> bytes:
    try:
        size, crc = struct.unpack_from("<QI", entry.data, 16)
        compression, at = _text(entry.data, 28)
        (length,) = struct.unpack_from("<Q", entry.data, at)
        packed = entry.data[at + 8 : at + 8 + length]
        if size > _LARGEST_CHUNK:
            raise _DamagedError(f"chunk at byte {entry.at} claims {size} bytes, more than {_LARGEST_CHUNK}")
        if compression == "zstd":
            # the frame's own header also claims a size, and would be believed before ours
            if zstandard.frame_content_size(packed) not in (-1, size):
                raise _DamagedError(f"chunk at byte {entry.at} contradicts its own size")
            raw = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        elif not compression:
            raw = bytes(packed)
        else:
            raise _DamagedError(f"chunk at byte {entry.at} is compressed with {compression!r}; this version reads zstd")
    except (*_MALFORMED, zstandard.ZstdError) as error:
        raise _DamagedError(f"chunk at byte {entry.at}: {error}") from error
    if len(raw) != size or crc not in (0, zlib.crc32(raw)):
        raise _DamagedError(f"chunk at byte {entry.at} fails its checksum")
    return raw


def _check_data(data: memoryview, entry: _Entry) -> None:
    crc = struct.unpack_from("<I", entry.data)[0] if len(entry.data) >= 4 else 0
    if crc not in (0, zlib.crc32(data[: entry.at - _HEAD.size])):
        raise _DamagedError("the data section fails its checksum")


def _text(data: memoryview, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise IndexError(f"text of {length} bytes leaves its record")
    return str(data[at + 4 : end], "utf-8"), end


def _map(data: memoryview, at: int) -> dict[str, str]:
    (length,) = struct.unpack_from("<I", data, at)
    at, end, facts = at + 4, at + 4 + length, {}
    while at < end:
        key, at = _text(data, at)
        facts[key], at = _text(data, at)
    return facts


def _assemble(path: Path, content: _Content, incomplete: str) -> Session:
    payload = _flat(content, TICK)
    recorded = content.metadata.get("integrity", {}).get("payload_sha256")
    ticks_announced = any(topic == TICK.topic for topic, _ in content.channels.values())
    if not (ticks_announced or content.library.startswith(_LIBRARY)) or (recorded is None and not incomplete):
        raise SessionError(f"{path}: is an MCAP file, but no session of this program")
    if recorded is not None and recorded != hashlib.sha256(payload).hexdigest():
        raise _DamagedError("the ticks do not match the hash that was recorded with them")
    return Session(
        path,
        TICK.array(payload),
        payload,
        TRUTH.array(_flat(content, TRUTH)),
        content.metadata,
        content.attachments,
        content.channel_facts,
        len(content.messages.get(LOG_TOPIC, ())),
        incomplete,
    )


def _flat(content: _Content, message: Message) -> bytes:
    """All messages of one constant layout, back to back."""
    for topic, number in content.channels.values():
        if topic == message.topic and content.schemas.get(number) != (message.name, message.descriptor()):
            raise _DamagedError(
                f"{topic} has another layout than {message.name} here: another version of this program made it"
            )
    messages = content.messages.get(message.topic, [])
    payload = b"".join(messages)
    if any(len(data) != message.size for data in messages) or not message.well_formed(payload):
        raise _DamagedError(f"a message of {message.topic} has not the layout of {message.name}")
    return payload
