"""The newest part of a run: what its two rings hold, of which the session file is told piece by piece."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from inteco_abs.format import TICK, TRUTH, Message
from inteco_abs.realtime.ring import RingReader

_BLOCK: Final = 4096
_SPARE: Final = 0.125
"""Share of a ring that the loop may fill while it is read: seconds, where reading takes tenths."""


class Window:
    """Ticks, and states of the simulated rig, that are in memory: while they come, or when the run is `over`."""

    def __init__(self, ticks: RingReader, truths: RingReader, *, over: bool = False) -> None:
        self._ticks, self._truths = ticks, truths
        self._spare = 0.0 if over else _SPARE
        self._end, self._truths_end = (each.written if over else each.taken for each in (ticks, truths))
        self._first_truth = 0

    @property
    def room(self) -> int:
        """Ticks that still come in before one is refused."""
        return min(self._ticks.room, self._truths.room)

    @property
    def waiting(self) -> int:
        """Ticks that were handed over and not released."""
        return self._end - self._ticks.taken

    def more(self) -> tuple[bytes, bytes]:
        """Ticks and states that came since the call before, to be handed over; they stay here until `release`."""
        ticks, self._end = self._ticks.look(self._end)
        truths, self._truths_end = self._truths.look(self._truths_end)  # behind the ticks: all that these have seen
        return ticks, truths

    def skip_truths(self) -> None:
        """Leave out the states that came before now."""
        self._first_truth = self._truths_end = self._truths.written
        self._truths.release(self._truths_end)

    def release(self) -> None:
        """What was handed over is in a file: its place may be used again."""
        self._ticks.release(self._end)
        self._truths.release(self._truths_end)

    @property
    def ticks(self) -> range:
        """Numbers of the ticks that were handed over and are still here, released or not."""
        return range(self._ticks.held_from(self._spare), self._end)

    @property
    def truths(self) -> range:
        """The same of the states."""
        return range(max(self._truths.held_from(self._spare), self._first_truth), self._truths_end)

    def held(self) -> Iterator[tuple[bytes, bytes]]:
        """All of these in blocks: ticks, each with the states that they have seen or that came in a block before."""
        truth, truths_end, newest_ns = self.truths.start, self.truths.stop, -1
        for number in self.ticks[::_BLOCK]:
            ticks, _ = self._ticks.look(number, min(_BLOCK, self._end - number))
            truths = list[bytes]()
            while truth < truths_end and newest_ns <= _newest_ns(TICK, ticks):
                block, truth = self._truths.look(truth, min(_BLOCK, truths_end - truth))
                truths.append(block)
                newest_ns = _newest_ns(TRUTH, block)
            yield ticks, b"".join(truths)
        if truth < truths_end:
            yield b"", self._truths.look(truth, truths_end - truth)[0]


def _newest_ns(message: Message, rows: bytes) -> int:
    return int(message.array(rows)["time_ns"].max(initial=0))
