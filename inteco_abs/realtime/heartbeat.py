"""A heartbeat from a thread, for processes whose main thread may block."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from typing import Final

from inteco_abs.errors import BoardError
from inteco_abs.realtime.memory import Field, RunMemory
from inteco_abs.realtime.tuning import Tuning, apply

NO_MORE: Final = "end other programs, or raise the limit of processes (ulimit -u); nothing was started"


@contextmanager
def repeating(act: Callable[[], object], every_s: float, tunings: Collection[Tuning] = ()) -> Iterator[None]:
    """Call `act` every `every_s` seconds in a thread with this tuning. Raises BoardError if no thread starts."""
    over = threading.Event()

    def repeat() -> None:
        apply(tunings)
        while not over.wait(every_s):
            act()

    thread = threading.Thread(target=repeat, daemon=True)
    try:
        thread.start()
    except RuntimeError as error:
        raise BoardError(f"no thread can be started ({error}): {NO_MORE}") from error
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def beating(memory: RunMemory, word: Field, every_s: float, tunings: Collection[Tuning] = ()) -> Iterator[None]:
    """Write the monotonic time in ns to `word` every `every_s` seconds; see `repeating`."""

    def beat() -> None:
        memory.words[word] = time.monotonic_ns()

    with repeating(beat, every_s, tunings):
        yield
