"""Keeps a run in shared memory, where `recover` finds it, when no disk takes it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from inteco_abs.control import GainChange
from inteco_abs.realtime.frame_spool import spool_frames
from inteco_abs.realtime.gain_changes import ChangeTable
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Mailbox, RunMemory
from inteco_abs.realtime.ring import TickRing
from inteco_abs.realtime.window import Window
from inteco_abs.sessions import TICK, TRUTH, RunEnd, RunHeader


def spool_run(
    job: Job, header: RunHeader, end: RunEnd, window: Window, file: Path, changes: Sequence[GainChange] = ()
) -> Path:
    """Copy what `window` holds of a run in virtual time, and its `changes` of gains, into new shared memory.

    Returns its path. Earlier ticks are in `file`. Raises SessionError if there is not enough memory.
    """
    ticks, truths = window.ticks, window.truths
    memory = RunMemory.create(TICK.size, max(len(ticks), 1), TRUTH.size, max(len(truths), 1))
    job.post(memory)
    memory.post(Mailbox.TROUBLES, {"texts": [], "file": str(file)})
    memory.post(Mailbox.ENVIRONMENT, header.environment.as_note())
    numbers = {"identity": dict(header.identity), "gains": dict(header.gains), "internals": header.internals}
    memory.post(Mailbox.HEADER, {**numbers, "declared": header.declared, "settings": []})
    memory.post(Mailbox.RUN_END, {"reason": int(end.reason), "detail": end.detail, "aborted": end.aborted, "cost": {}})
    ring, states = memory.tick_ring(_copy, ticks.start), memory.truth_ring(_copy, truths.start)
    for records, seen in window.held():
        _fill(ring, records, TICK.size)
        _fill(states, seen, TRUTH.size)
    table = ChangeTable(memory, (gain.name for gain in header.declared))
    for change in changes:
        table.record(change)
    if end.frames is not None:
        spool_frames(memory, end.frames)
    memory.keep()
    return memory.path


def _copy(buffer: Any, at: int, record: bytes) -> None:
    buffer[at : at + len(record)] = record


def _fill(ring: TickRing, records: bytes, size: int) -> None:
    for at in range(0, len(records), size):
        ring.append(records[at : at + size])
