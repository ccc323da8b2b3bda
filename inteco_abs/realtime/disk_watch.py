"""Reports trouble with the recorder's disk at once, and ends the run before a ring is full."""

from __future__ import annotations

from typing import Final

from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.screen import Screen
from inteco_abs.signals import Reason

_SLOW_S: Final = 2.0
_STOP_S: Final = 1.0
"""Time within which a run that has to stop has ended."""


class DiskWatch:
    """Watches the recorder of the run in `memory`."""

    def __init__(self, memory: RunMemory, job: Job) -> None:
        self._memory, self._job = memory, job
        self._ticks, self._truths = memory.tick_reader(), memory.truth_reader()
        self._reported = 0
        self._slow = False

    def look(self, screen: Screen) -> None:
        """Report new trouble, and stop the run before its ticks or its rig's states have no room left."""
        self._report_troubles(screen)
        self._report_slowness(screen)
        words = self._memory.words
        room = min(self._ticks.room, self._truths.room)
        if room < _STOP_S * self._job.config.loop.rate_hz and not words[Field.STOP]:
            words[Field.STOP] = Reason.RECORDER_LOST

    def _report_troubles(self, screen: Screen) -> None:
        if self._memory.words[Field.TROUBLES] == self._reported:
            return
        note = self._memory.note(Mailbox.TROUBLES)
        if note is not None:
            for text in note["texts"][self._reported :]:
                screen.warn(text)
            self._reported = len(note["texts"])

    def _report_slowness(self, screen: Screen) -> None:
        words = self._memory.words
        behind = self._ticks.written - words[Field.SYNCED]
        if not (self._slow or words[Field.TROUBLES]) and behind > _SLOW_S * self._job.config.loop.rate_hz:
            self._slow = True
            screen.warn(f"the disk of {self._job.session} is slow: ticks are in memory only for now; the run continues")
