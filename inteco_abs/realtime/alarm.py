"""The word to the user while the board is held and nobody drives it: only the emergency switch may help by then."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from inteco_abs.boards import STILL_ON
from inteco_abs.realtime.memory import Field, RunMemory
from inteco_abs.realtime.rules import Silence

_WINDOW_NS: Final = 300_000_000
_TURN_NS: Final = 100_000_000
_POLL_NS: Final = 20_000_000
TEXT: Final = f"no tick for 0.3 s, and the board is not safe yet. {STILL_ON}"


class Alarm:
    """In each process that may outlive the loop: the first in `turn` says it, the next if that one has not."""

    def __init__(self, memory: RunMemory, turn: int, say: Callable[[str], bool] | None = None) -> None:
        """`say` gives whether it could; by default it is the terminal's error output."""
        self._words = memory.words
        self._ticks = memory.tick_reader()
        self._silence = Silence(_WINDOW_NS + turn * _TURN_NS, _POLL_NS)
        self._say = say or self._aloud
        self._before_ns = time.monotonic_ns()
        self._tried = False

    def look(self) -> None:
        """Say it once if the loop holds the board and has not completed a tick for too long; often called."""
        now_ns = time.monotonic_ns()
        passed_ns, self._before_ns = now_ns - self._before_ns, now_ns
        words = self._words
        holder = words[Field.HOLDER_PID]
        held = holder == words[Field.LOOP_PID] != 0 and words[Field.RESCUED_PID] != holder
        if not held or not self._ticks.written:
            self._silence.forget()
        elif self._silence.lasts(self._ticks.written, passed_ns) and not self._tried:
            self._tried = True
            if not words[Field.ALARMED] and self._say(TEXT):
                words[Field.ALARMED] = 1

    def _aloud(self, text: str) -> bool:
        """From a thread: a terminal that was halted keeps its writer waiting, and whoever watches must not wait."""

        def write() -> None:
            with suppress(OSError, ValueError):
                os.write(2, f"\ninteco-abs: {text}\n".encode())
                self._words[Field.ALARMED] = 1

        with suppress(RuntimeError):  # no more threads: the next in turn says it
            threading.Thread(target=write, daemon=True).start()
        return False
