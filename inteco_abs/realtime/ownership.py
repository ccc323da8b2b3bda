"""What a process does that holds the board: be watched first, let go last, and say what went wrong."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from inteco_abs.errors import AbsError, BoardError, UnsafeError, in_words
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory, alive

PATIENCE_S: Final = 60.0


@contextmanager
def holding(memory: RunMemory) -> Iterator[None]:
    """Around opening, using and leaving the board, and watched by the guardian before that.

    A board that could not be made safe stays held, so that the guardian takes it when this process ends.
    """
    words, pid = memory.words, os.getpid()
    memory.wait(lambda: words[Field.GUARDING_PID] == pid or stopped(memory), PATIENCE_S)
    if words[Field.GUARDING_PID] != pid:
        raise BoardError("the guardian does not watch, so the board was not opened")
    words[Field.HOLDER_PID] = pid
    try:
        yield
    except UnsafeError:
        raise
    except BaseException:
        words[Field.HOLDER_PID] = 0
        raise
    words[Field.HOLDER_PID] = 0


def stopped(memory: RunMemory) -> bool:
    """Whether anybody wants the run to end, or nobody is left who could let it begin."""
    words = memory.words
    return bool(words[Field.STOP] or words[Field.GUARDIAN_STOP]) or not alive(words[Field.SUPERVISOR_PID])


def tell_failure(memory: RunMemory, note: Mailbox, error: BaseException) -> None:
    """Leave what went wrong for the supervisor, who raises it again."""
    text = str(error) if isinstance(error, AbsError) else in_words(error)
    memory.post(note, {"kind": type(error).__name__, "text": text, "notes": getattr(error, "__notes__", [])})
