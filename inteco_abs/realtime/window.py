"""The newest part of a run, which its two rings hold, for the session file to take block by block."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

from inteco_abs.format import TICK, TRUTH, Message
from inteco_abs.realtime.ring import RingReader

_BLOCK: Final = 4096
_SPARE: Final = 0.125
"""Share of a ring that the loop may fill while it is read: seconds, while reading takes tenths of one."""


class Window:
    """Ticks and states of the simulated rig in memory, during the run or when it is `over`."""

    def __init__(self, ticks: RingReader, truths: RingReader, *, over: bool = False) -> None:
        self._ticks, self._truths = ticks, truths
        self._spare = 0.0 if over else _SPARE
        self._end, self._truths_end = (each.written if over else each.taken for each in (ticks, truths))
        self._first_truth = 0
        self._returned = deque[tuple[int, int]]()
        """Ends of what each call of `more` has returned and `release` has not freed, in ticks and states."""

    @property
    def end(self) -> int:
        """Number of ticks that `more` has returned."""
        return self._end

    @property
    def room(self) -> int:
        """Number of ticks before a ring is full."""
        return min(self._ticks.room, self._truths.room)

    @property
    def waiting(self) -> int:
        """Number of ticks that were returned by `more` and not released."""
        return self._end - self._ticks.taken

    def more(self, *, last: bool) -> tuple[bytes, bytes]:
        """Return the ticks and states since the previous call; they stay in memory until `release`.

        States after the newest tick wait for the next call, unless this is the `last`, so that a file has all by time.
        """
        ticks, self._end = self._ticks.look(self._end)
        truths, end = self._truths.look(self._truths_end)  # after the ticks: all states before them
        if not last:
            times_ns = TRUTH.array(truths)["time_ns"]
            known = int(times_ns.searchsorted(_newest_ns(TICK, ticks), side="right"))
            truths, end = truths[: known * TRUTH.size], end - (len(times_ns) - known)
        self._truths_end = end
        if ticks or truths:
            self._returned.append((self._end, self._truths_end))
        return ticks, truths

    def skip_truths(self) -> None:
        """Drop the states so far."""
        self._first_truth = self._truths_end = self._truths.written
        self._truths.release(self._truths_end)

    def release(self, stored: int) -> None:
        """Free the place of the first `stored` ticks, which are in a file, and of the states that came with them."""
        while self._returned and self._returned[0][0] <= stored:
            ticks, truths = self._returned.popleft()
            self._ticks.release(ticks)
            self._truths.release(truths)

    @property
    def ticks(self) -> range:
        """Numbers of the ticks that `more` has returned and that are still in memory, released or not."""
        return range(self._ticks.held_from(self._spare), self._end)

    @property
    def truths(self) -> range:
        """Numbers of the states that `more` has returned and that are still in memory."""
        return range(max(self._truths.held_from(self._spare), self._first_truth), self._truths_end)

    def held(self) -> Iterator[tuple[bytes, bytes]]:
        """Yield all of these in blocks of ticks, with the states up to their time."""
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
