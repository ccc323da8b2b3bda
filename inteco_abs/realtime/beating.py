"""A sign of life from a thread of its own, for processes whose work may take its time."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from inteco_abs.errors import BoardError
from inteco_abs.realtime.memory import RunMemory, Word

NO_MORE: Final = "end other programs, or raise the limit of processes (ulimit -u); nothing was started"


@contextmanager
def beating(memory: RunMemory, word: Word, every_s: float) -> Iterator[None]:
    """While inside, note the time in `word` so often. Raises BoardError if no thread can be started for that."""
    over = threading.Event()

    def beat() -> None:
        while not over.wait(every_s):
            memory.words[word] = time.monotonic_ns()

    thread = threading.Thread(target=beat, daemon=True)
    try:
        thread.start()
    except RuntimeError as error:
        raise BoardError(f"no thread can be started ({error}): {NO_MORE}") from error
    try:
        yield
    finally:
        over.set()
        thread.join()
