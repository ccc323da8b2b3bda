"""Reads a session's metadata through the index and no tick: hundreds of files take a second.

It checks the index's checksum only; `validate` checks all.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, Final

from inteco_abs.sessions.container import (
    HEAD,
    LARGEST_RECORD,
    MAGIC,
    DamagedError,
    Entry,
    Opcode,
    chunk_parts,
    fields,
)
from inteco_abs.sessions.content import Content
from inteco_abs.sessions.migration import Metadata, migrated

_FOOTER: Final = struct.Struct("<QQI")
_TAIL: Final = HEAD.size + _FOOTER.size + len(MAGIC)
_LARGEST_METADATA: Final = 1 << 22


def read_metadata(file: BinaryIO, size: int) -> Metadata:
    """Metadata of the session in an open file, as in `Session`. Raises DamagedError if the index is damaged."""
    content = Content()
    places = sorted(
        tuple(fields(entry.opcode, entry.data)[:2])
        for entry in _summary(file, size)
        if entry.opcode == Opcode.METADATA_INDEX
    )
    for at, length in places:
        if length > _LARGEST_METADATA or at + length > size:
            raise DamagedError("the index names a place outside of the file")
        file.seek(at)
        record = file.read(length)
        if len(record) < HEAD.size or HEAD.unpack_from(record) != (Opcode.METADATA, length - HEAD.size):
            raise DamagedError("the index names a place where no metadata is")
        content.take(Entry(Opcode.METADATA, at + HEAD.size, memoryview(record)[HEAD.size :]))
    return migrated(content.metadata)


def _summary(file: BinaryIO, size: int) -> Iterator[Entry]:
    """Records between the data and the footer."""
    if size < _TAIL:
        raise DamagedError("there is no index")
    file.seek(-_TAIL, os.SEEK_END)
    tail = file.read(_TAIL)
    start, _, crc = _FOOTER.unpack_from(tail, HEAD.size)
    end = size - _TAIL
    if not tail.startswith(HEAD.pack(Opcode.FOOTER, _FOOTER.size)) or not tail.endswith(MAGIC):
        raise DamagedError("there is no index")
    if not 0 < end - start <= LARGEST_RECORD:
        raise DamagedError("the index is not where the footer says")
    file.seek(start)
    summary = file.read(end - start)
    if crc != zlib.crc32(tail[: HEAD.size + _FOOTER.size - 4], zlib.crc32(summary)):
        raise DamagedError("the index fails its checksum")
    return (part for part in chunk_parts(summary) if isinstance(part, Entry))
