"""Handles, for a while, the signals that would end the program."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

_UNCATCHABLE: Final = ("SIGKILL", "SIGSTOP")
_HARMLESS: Final = ("SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO")
"""Ignored by default (signal(7))."""
_FAULTS: Final = ("SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL")
"""After a handler the same instruction would fail again, for ever."""
_ERRORS: Final = ("SIGPIPE", "SIGXFSZ")
"""Python ignores them: the write that fails says so."""
_BACKGROUND: Final = ("SIGTTIN", "SIGTTOU")
"""After a handler the same call on the terminal would raise it again, for ever."""


@contextmanager
def handle_signals(handle: Callable[[], None]) -> Iterator[None]:
    """Call `handle` for every signal that would end or freeze the program with its outputs on.

    Does nothing in a thread other than the main one.
    """
    if threading.current_thread() is not threading.main_thread():  # Python delivers signals to no other
        yield
        return
    before = {number: signal.signal(number, lambda *_: handle()) for number in handled_signals()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: it was not set by Python


def handled_signals() -> set[int]:
    """Return the numbers of the signals that `handle_signals` handles, with the real-time signals."""
    left = (*_UNCATCHABLE, *_HARMLESS, *_FAULTS, *_ERRORS, *_BACKGROUND)
    return {int(number) for number in signal.valid_signals()} - {getattr(signal, name, None) for name in left}
