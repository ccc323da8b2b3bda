"""Raw frames of a run: from a recording of the wire into the session, and from the session into a capture."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final

from inteco_abs.errors import SessionError
from inteco_abs.format import IO_TOPIC, Direction, IoFrame, pack_io_frame, unpack_io_frame
from inteco_abs.sessions.container import (
    DamagedError,
    DecompressionBudget,
    Entry,
    FixedRun,
    Opcode,
    chunk_parts,
    unpack_chunk,
)
from inteco_abs.sessions.content import Content
from inteco_abs.sessions.reader import opened
from inteco_abs.sessions.scanner import RecordFile
from inteco_abs.wire import Capture, Record, RecordKind

Frames = Callable[[], AbstractContextManager[tuple[Capture, Iterable[Record]]]]
"""Opens the recording: its header, and its records one by one. Raises CaptureError if there is none."""
_HEAD: Final = ("board", "recorded_by", "clock")


def frame_facts(head: Capture) -> dict[str, str]:
    """Header of a recording, for the metadata of the frames' channel."""
    return {**{name: getattr(head, name) for name in _HEAD}, "start_ns": str(head.start_ns or 0)}


def packed_frames(head: Capture, records: Iterable[Record]) -> Iterator[tuple[int, bytes]]:
    """Monotonic time in ns and message of each record of a host's recording."""
    start_ns = head.start_ns or 0
    for record in records:
        time_ns = start_ns + round(record.t_s * 1e9)
        yield time_ns, pack_io_frame(IoFrame(time_ns, _DIRECTIONS[record.kind], record.data, record.text, record.of))


def read_frames(path: Path) -> Capture:
    """The raw frames of the session at `path`; a warning follows them if some may be missing.

    Raises SessionError if it has no frames, cannot be read, or is damaged.
    """
    messages: list[bytes] = []
    ended = False
    with opened(path) as (file, size):
        content = Content(budget=DecompressionBudget(size))
        try:
            for entry in RecordFile(file, size):
                if entry.opcode == Opcode.DATA_END:
                    ended = True
                    break
                if entry.opcode == Opcode.CHUNK:
                    messages += _messages(content, unpack_chunk(entry.data, content.budget))
                else:
                    content.take(entry)
            missing = content.metadata.get("frames", {}).get("missing", "")
            return _capture(path, content, messages, missing if ended else "the file ends early")
        except DamagedError as error:
            raise SessionError(f"{path}: is damaged: {error}; inteco-abs recover saves what is intact") from error


def _messages(content: Content, raw: bytes) -> Iterator[bytes]:
    for part in chunk_parts(raw, content.variable_size):
        if isinstance(part, Entry):
            content.take(part)
            continue
        if isinstance(part, FixedRun):
            content.budget.part()
        else:
            content.budget.part(part.number)
            yield from (data for _, _, data in part.messages())


def _capture(path: Path, content: Content, messages: Iterable[bytes], missing: str) -> Capture:
    facts = content.channel_facts.get(IO_TOPIC)
    if facts is None:
        raise SessionError(f"{path}: has no raw frames: {missing or 'record them with inteco-abs run --frames'}")
    try:
        start_ns = int(facts["start_ns"])
        board, recorded_by, clock = (facts[name] for name in _HEAD)
        records = [_record(unpack_io_frame(data), start_ns) for data in messages]
    except (KeyError, ValueError, OverflowError) as error:
        raise DamagedError(f"its raw frames cannot be read: {error}") from error
    if missing:
        text = f"the session may lack messages: {missing}"
        records.append(Record(records[-1].t_s if records else 0.0, RecordKind.WARNING, text=text))
    return Capture(board, recorded_by, clock, tuple(records), str(path), start_ns)


def _record(frame: IoFrame, start_ns: int) -> Record:
    t_s = round((frame.time_ns - start_ns) * 1e-9, 9)  # as in a capture
    return Record(t_s, _KINDS[frame.direction], None, frame.data, frame.text, frame.of)


_DIRECTIONS: Final[Mapping[RecordKind, Direction]] = {
    RecordKind.OUT: Direction.OUT,
    RecordKind.IN: Direction.IN,
    RecordKind.ERROR: Direction.ERROR,
    RecordKind.WARNING: Direction.WARNING,
}
_KINDS: Final = {direction: kind for kind, direction in _DIRECTIONS.items()}
