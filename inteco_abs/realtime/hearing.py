"""Signals that would end or stop the program, heard by a handler of ours for a while."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

_ENDING: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGXCPU")
"""Each of these would otherwise leave the program, or freeze it, with its outputs on."""


@contextmanager
def hearing(handle: Callable[[], None]) -> Iterator[None]:
    """While inside, such a signal calls `handle` and does nothing else; only the main thread changes anything."""
    if threading.current_thread() is not threading.main_thread():  # Python delivers signals to no other
        yield
        return
    wanted = [getattr(signal, name) for name in _ENDING if hasattr(signal, name)]
    before = {number: signal.signal(number, lambda *_: handle()) for number in wanted}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: it was not set by Python
