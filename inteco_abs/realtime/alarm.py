"""Warns the user when the board is held but no loop drives it: then only the emergency switch may help."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from inteco_abs.boards import STILL_ON
from inteco_abs.realtime.failure_rules import Silence
from inteco_abs.realtime.memory import Field, RunMemory

_WINDOW_NS: Final = 300_000_000
_TURN_NS: Final = 100_000_000
_POLL_NS: Final = 20_000_000
TEXT: Final = f"no tick for 0.3 s, and the board is not safe yet. {STILL_ON}"


class Alarm:
    """Runs in each process that may outlive the loop; the next in `turn` warns if the one before has not."""

    def __init__(self, memory: RunMemory, turn: int, say: Callable[[str], bool] | None = None) -> None:
        """`say` returns whether it could warn; by default the warning goes to standard error."""
        self._words = memory.words
        self._ticks = memory.tick_reader()
        self._silence = Silence(_WINDOW_NS + turn * _TURN_NS, _POLL_NS)
        self._say = say or self._write_stderr
        self._before_ns = time.monotonic_ns()
        self._tried = False

    def look(self) -> None:
        """Warn once if the loop holds the board and has completed no tick within the window; call it often."""
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

    def _write_stderr(self, text: str) -> bool:
        """Write from a thread: a halted terminal blocks its writer, and the watching process must not block."""

        def write() -> None:
            with suppress(OSError, ValueError):
                os.write(2, f"\ninteco-abs: {text}\n".encode())
                self._words[Field.ALARMED] = 1

        with suppress(RuntimeError):  # no thread left: the next in turn warns
            threading.Thread(target=write, daemon=True).start()
        return False
