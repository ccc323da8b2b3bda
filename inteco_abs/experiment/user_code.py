"""Time limit for a user's code before a run."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType
from typing import Final

from inteco_abs.errors import ConfigError
from inteco_abs.plugins import LOADING_MOST_S

_AGAIN_S: Final = 1.0


class _TimeUp(BaseException):
    """Raised after TimeoutError, for code that catches every Exception."""


class time_limit:  # noqa: N801  used as a function, as the context managers of contextlib are
    """Raise TimeoutError, then ConfigError, in code that takes longer than 60 s.

    Only in the main thread, which gets signals, on POSIX. An alarm of the caller continues afterwards.
    """

    def __init__(self) -> None:
        self._problem = f"not finished within {LOADING_MOST_S:g} s"
        self._raised = iter([TimeoutError(self._problem)])
        self._acts = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")

    def __enter__(self) -> None:
        if self._acts:
            self._caller = sys._getframe(1)  # noqa: SLF001  inspect has it only with None for other Pythons
            self._handler = signal.signal(signal.SIGALRM, self._expire)
            self._timer = signal.setitimer(signal.ITIMER_REAL, LOADING_MOST_S, _AGAIN_S)

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if not self._acts:
            return
        self._acts = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_IGN)  # drops one that is on its way
        signal.signal(signal.SIGALRM, signal.SIG_DFL if self._handler is None else self._handler)
        signal.setitimer(signal.ITIMER_REAL, *self._timer)
        if isinstance(error, _TimeUp):
            raise ConfigError.of("--controller", self._problem) from None

    def _expire(self, _signal: int, frame: FrameType | None) -> None:
        # raised where the limit begins or ends, it would leave the alarm on, and raise in what comes later
        own = (time_limit.__enter__.__code__, time_limit.__exit__.__code__)
        if not self._acts or (frame is not None and frame.f_code in own):
            return
        while frame is not None and frame is not self._caller:
            frame = frame.f_back
        if frame is not None:
            raise next(self._raised, _TimeUp())
        signal.setitimer(signal.ITIMER_REAL, 0.0)  # Ctrl-C where the limit ended has left it on
