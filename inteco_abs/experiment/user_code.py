"""Time limit for a user's code before a run."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from inteco_abs.errors import ConfigError
from inteco_abs.plugins import LOADING_MOST_S

_AGAIN_S: Final = 1.0


class _TimeUp(BaseException):
    """Raised after TimeoutError, for code that catches every Exception."""


@contextmanager
def time_limit() -> Iterator[None]:
    """Raise TimeoutError, then ConfigError, in code that takes longer than 60 s.

    Only in the main thread, which gets signals, on POSIX. An alarm of the caller continues afterwards.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    problem = f"not finished within {LOADING_MOST_S:g} s"
    raised = iter([TimeoutError(problem)])

    def expire(*_: object) -> None:
        raise next(raised, _TimeUp())

    before = signal.signal(signal.SIGALRM, expire)
    theirs = signal.setitimer(signal.ITIMER_REAL, LOADING_MOST_S, _AGAIN_S)
    try:
        yield
    except _TimeUp:
        raise ConfigError.of("--controller", problem) from None
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL if before is None else before)
        signal.setitimer(signal.ITIMER_REAL, *theirs)
