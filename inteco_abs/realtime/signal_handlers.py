"""Signals that would end the program, heard by a handler of ours for a while."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

_UNCATCHABLE: Final = ("SIGKILL", "SIGSTOP")
_HARMLESS: Final = ("SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGINFO")
"""Ignored unless somebody handles them (signal(7))."""
_FAULTS: Final = ("SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL")
"""After a handler of ours, the same instruction would fail again, for ever."""
_ERRORS: Final = ("SIGPIPE", "SIGXFSZ")
"""Python ignores them: the write that fails says so."""
_BACKGROUND: Final = ("SIGTTIN", "SIGTTOU")
"""After a handler of ours, the same call on the terminal would raise it again, for ever."""


@contextmanager
def hearing(handle: Callable[[], None]) -> Iterator[None]:
    """While inside, every signal that would leave the program, with its outputs on, calls `handle` instead.

    So does SIGTSTP, which would freeze it. Only the main thread changes anything.
    """
    if threading.current_thread() is not threading.main_thread():  # Python delivers signals to no other
        yield
        return
    before = {number: signal.signal(number, lambda *_: handle()) for number in heard_signals()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)  # None: it was not set by Python


def heard_signals() -> set[int]:
    """Numbers of the signals that `hearing` hears, real-time signals among them."""
    unheard = (*_UNCATCHABLE, *_HARMLESS, *_FAULTS, *_ERRORS, *_BACKGROUND)
    return {int(number) for number in signal.valid_signals()} - {getattr(signal, name, None) for name in unheard}
