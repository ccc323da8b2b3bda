"""Writes the content of a session to a new file: all of it or a part, with other metadata and attachments."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np

from inteco_abs.format import IO_TOPIC
from inteco_abs.sessions.channels import gains_of, internals_of
from inteco_abs.sessions.content import LogEntry, changes_among
from inteco_abs.sessions.file_writer import FileWriter
from inteco_abs.sessions.frames import packed_frames, read_frames
from inteco_abs.sessions.reader import Session
from inteco_abs.sessions.rows import Array, Part

_REWRITTEN: Final = ("result", "integrity")
_KNOWN: Final = ("outcome", "reason", "ticks", "overruns", "lost_ticks", "ended_utc", "session_id", "started_utc")
"""Facts about the session that a writer writes itself."""


def write_copy(
    session: Session,
    path: Path,
    blocks: Iterable[Part],
    *,
    metadata: Mapping[str, Mapping[str, str]],
    attachments: Mapping[str, bytes],
    card: Mapping[str, Any],
    log: Iterable[LogEntry] = (),
    frames: bool = False,
) -> None:
    """Write the ticks and truths of `blocks` to the new file `path`, as the same session at the same time of day.

    Changes of phase and faults are logged again; `log` has other entries. Gains and reference, and their changes, are
    those of the session. Raises SessionError.
    """
    facts = session.metadata.get("session", {})
    parts = iter(blocks)
    first, states = next(parts)
    with FileWriter(
        path,
        int(first["time_ns"][0]),
        facts.get("session_id", ""),
        session.epoch_ns,
        internals=internals_of(session.channels),
        gains=gains_of(session.channels),
    ) as recorder:
        for name, record in metadata.items():
            left = {key: value for key, value in record.items() if name != "session" or key not in _KNOWN}
            if left and name not in _REWRITTEN:
                recorder.describe(name, left)
        for name, data in attachments.items():
            recorder.attach(name, session.media_types.get(name, ""), data)
        recorder.begin(next((part.values for part in session.parameters if not part.tick), {}))
        recorder.change(changes_among(session.parameters))
        for _ in copy_rows(recorder, chain([(first, states)], parts), log, session.epoch_ns):
            pass
        if frames and session.frames:
            capture = read_frames(session.path)
            recorder.frames(session.channels[IO_TOPIC], packed_frames(capture, capture.records))
        recorder.finish(facts.get("outcome", ""), facts.get("reason", ""), card, facts.get("ended_utc", ""))


def copy_rows(recorder: FileWriter, blocks: Iterable[Part], log: Iterable[LogEntry], epoch_ns: int) -> Iterator[Part]:
    """Write blocks of ticks and truths, and each entry of the log after the ticks before it; yield what was written."""
    waiting = sorted(log, reverse=True)

    def write(ticks: Array, truths: Array) -> Part:
        recorder.truths(truths.tobytes())
        recorder.ticks(ticks.tobytes())
        return ticks, truths

    for ticks, states in blocks:
        while waiting and len(ticks) and waiting[-1].unix_ns - epoch_ns <= int(ticks["time_ns"][-1]):
            now_ns = np.uint64(max(0, waiting[-1].unix_ns - epoch_ns))
            tick, state = (int(rows["time_ns"].searchsorted(now_ns, side="right")) for rows in (ticks, states))
            yield write(ticks[:tick], states[:state])
            recorder.event(*waiting.pop())
            ticks, states = ticks[tick:], states[state:]  # noqa: PLW2901  the rest of the block
        yield write(ticks, states)
    for entry in reversed(waiting):
        recorder.event(*entry)
