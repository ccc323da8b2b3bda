"""Keeps a run in memory that no disk has taken, where `recover` finds it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from inteco_abs.realtime.frames import stow_frames
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Mailbox, RunMemory
from inteco_abs.realtime.ring import TickRing
from inteco_abs.realtime.window import Window
from inteco_abs.sessions import TICK, TRUTH, RunEnd, RunHeader


def stow(job: Job, introduction: RunHeader, end: RunEnd, window: Window, file: Path) -> Path:
    """A ring with what the window holds of a run that another process than a recorder's has recorded.

    What came before that is in the `file`. Raises SessionError if memory has no room for it.
    """
    ticks, truths = window.ticks, window.truths
    memory = RunMemory.create(TICK.size, max(len(ticks), 1), TRUTH.size, max(len(truths), 1))
    job.post(memory)
    memory.post(Mailbox.TROUBLES, {"texts": [], "file": str(file)})
    memory.post(Mailbox.SURROUNDINGS, introduction.surroundings.as_note())
    memory.post(
        Mailbox.INTRODUCTION,
        {
            "identity": dict(introduction.identity),
            "gains": dict(introduction.gains),
            "internals": list(introduction.internals),
            "settings": [],
        },
    )
    memory.post(
        Mailbox.CONCLUSION, {"reason": int(end.reason), "detail": end.detail, "aborted": end.aborted, "cost": {}}
    )
    ring, states = memory.tick_ring(_copy, ticks.start), memory.truth_ring(_copy, truths.start)
    for records, seen in window.held():
        _fill(ring, records, TICK.size)
        _fill(states, seen, TRUTH.size)
    if end.frames is not None:
        stow_frames(memory, end.frames)
    memory.keep()
    return memory.path


def _copy(buffer: Any, at: int, record: bytes) -> None:
    buffer[at : at + len(record)] = record


def _fill(ring: TickRing, records: bytes, size: int) -> None:
    for at in range(0, len(records), size):
        ring.append(records[at : at + size])
