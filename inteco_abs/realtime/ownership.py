"""Board ownership: a process is guarded before it opens the board, and reports why it failed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from inteco_abs.errors import AbsError, BoardError, UnsafeError, describe_error
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory, alive

PATIENCE_S: Final = 60.0


@contextmanager
def holding(memory: RunMemory) -> Iterator[None]:
    """Wait until the guardian watches this process, then mark it as the holder of the board inside the context.

    After UnsafeError the board stays held, so that the guardian takes it over when this process ends. Raises BoardError
    if the guardian does not watch.
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
    """Return whether the run has to end, or its supervisor has died."""
    words = memory.words
    return bool(words[Field.STOP] or words[Field.GUARDIAN_STOP]) or not alive(words[Field.SUPERVISOR_PID])


def run_role(path: str, act: Callable[[RunMemory, Job], None]) -> int:
    """Run one role of the run in the memory at `path`; post its AbsError, and return its exit code."""
    memory = RunMemory.open(Path(path))
    try:
        act(memory, Job.of(memory))
    except AbsError as error:
        post_failure(memory, Mailbox.FAILURE, error)
        return error.exit_code
    return 0


def post_failure(memory: RunMemory, note: Mailbox, error: BaseException) -> None:
    """Post an error for the supervisor, which raises it again."""
    text = str(error) if isinstance(error, AbsError) else describe_error(error)
    memory.post(note, {"kind": type(error).__name__, "text": text, "notes": getattr(error, "__notes__", [])})
