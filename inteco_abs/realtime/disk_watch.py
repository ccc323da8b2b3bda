"""What the supervisor has to know of the recorder's disk: trouble is said at once, and no tick goes without room."""

from __future__ import annotations

from typing import Final

from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.screen import Screen
from inteco_abs.signals import Reason

_SLOW_S: Final = 2.0
_STOP_S: Final = 1.0
"""Within which a run that is told to stop has ended."""


class DiskWatch:
    """Watches the recorder of the run in `memory`."""

    def __init__(self, memory: RunMemory, job: Job) -> None:
        self._memory, self._job = memory, job
        self._ticks = memory.tick_reader()
        self._heard = 0
        self._slow = False

    def look(self, screen: Screen) -> None:
        """Say what is new, and end the run in order before its ticks have no room left."""
        self._say_troubles(screen)
        self._say_if_slow(screen)
        words = self._memory.words
        if self._ticks.room < _STOP_S * self._job.config.loop.rate_hz and not words[Field.STOP]:
            words[Field.STOP] = Reason.RECORDER_LOST

    def _say_troubles(self, screen: Screen) -> None:
        if self._memory.words[Field.TROUBLES] == self._heard:
            return
        told = self._memory.note(Mailbox.TROUBLES)
        if told is not None:
            for text in told["texts"][self._heard :]:
                screen.warn(text)
            self._heard = len(told["texts"])

    def _say_if_slow(self, screen: Screen) -> None:
        words = self._memory.words
        behind = self._ticks.written - words[Field.FLUSHED]
        if not (self._slow or words[Field.TROUBLES]) and behind > _SLOW_S * self._job.config.loop.rate_hz:
            self._slow = True
            screen.warn(f"the disk of {self._job.session} is slow: for now, ticks are in memory only; the run goes on")
