"""Changes the description of a session afterwards. Its ticks stay, byte for byte; its history is kept."""

from __future__ import annotations

import json
import os
import shutil
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, Final

from inteco_abs.errors import SessionError, describe_disk
from inteco_abs.sessions.container import HEAD, DamagedError, Entry, Opcode, chunk_parts
from inteco_abs.sessions.content import PREFIX
from inteco_abs.sessions.files import atomic_write
from inteco_abs.sessions.mcap_writer import McapWriter
from inteco_abs.sessions.migration import Metadata
from inteco_abs.sessions.reader import opened, read_metadata, summary_of
from inteco_abs.sessions.rows import damaged
from inteco_abs.sessions.scanner import checksum
from inteco_abs.sessions.validation import Severity, validate

DESCRIPTION: Final = "description"
HISTORY: Final = "annotations"
"""Record with one entry per annotation: its UTC time, and as JSON who made it and the values before."""
_CRC: Final = struct.Struct("<I")
_END: Final = HEAD.size + _CRC.size
"""Bytes of the record that ends the data."""


def annotate(path: Path, changes: Mapping[str, str], by: str, at_utc: str) -> Metadata:
    """Give the description of the session at `path` other values; return the metadata that was written.

    `changes` are values by key of `description` in rig.toml, empty to take one away; `by` is who changes it, `at_utc`
    the time. The file is written again beside the old one and then takes its place. Raises SessionError for a file that
    is cut or damaged, or cannot be replaced.
    """
    if wrong := [issue for issue in validate(path).findings if issue.severity is Severity.WRONG]:
        raise SessionError(f"{path}: is not annotated: {wrong[0].place}: {wrong[0].problem}")
    try:
        before = read_metadata(path).get(DESCRIPTION, {})
        was = {key: before.get(key, "") for key in changes}
        entry = json.dumps({"by": by, "before": was})
        records = {DESCRIPTION: dict(changes), HISTORY: {at_utc: entry}}
        with atomic_write(path) as part, opened(path) as (file, size), part.open("xb") as copy:
            _copy(file, size, copy, records)
            copy.flush()
            os.fsync(copy.fileno())
            shutil.copymode(path, part)
    except DamagedError as error:
        raise damaged(path, error) from error
    except OSError as error:
        raise SessionError(f"{path} cannot be written: {describe_disk(error)}") from error
    return records


def _copy(file: BinaryIO, size: int, copy: BinaryIO, records: Metadata) -> None:
    """Copy a complete session with more metadata at the end of its data. Raises DamagedError without an index."""
    summary = summary_of(file, size)
    entries = [entry for entry in chunk_parts(summary.records) if isinstance(entry, Entry)]
    end = summary.start - _END
    file.seek(end)
    ended = file.read(_END)
    if HEAD.unpack_from(ended) != (Opcode.DATA_END, _CRC.size):
        raise DamagedError("the index does not follow the end of the data")
    file.seek(0)
    left = end
    while left:
        block = file.read(min(left, 1 << 20))
        copy.write(block)
        left -= len(block)
    writer = McapWriter.continued(copy, end, checksum(file, 0, end), entries)
    for name, facts in records.items():
        writer.add_metadata(f"{PREFIX}{name}", facts)
    writer.finish()
