"""Keys that stop a run without Enter: space and q, beside Ctrl-C."""

from __future__ import annotations

import os
import select
import signal
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

STOPPING: Final = frozenset(b" qQ")
_AT_ONCE: Final = 64
_PAUSE_S: Final = 0.2


@contextmanager
def stop_keys(stop: Callable[[], None], terminal: int = 0) -> Iterator[bool]:
    """While inside, such a key on the `terminal`, a file descriptor, calls `stop` from a thread; True if it can.

    It cannot where this is not a terminal, or where the program runs in the background. The terminal gets back the
    settings that it had, and keys that nobody asked for are dropped, whatever ends it. A program that was frozen and
    goes on, with its terminal meanwhile set up by a shell, sets it up again.
    """
    try:
        keyboard = _Keyboard(terminal)
        keyboard.take()
    except (OSError, termios.error):  # none, or closed by now
        yield False
        return
    leave, told = os.pipe()
    reader = threading.Thread(target=_read, args=(terminal, leave, stop), name="keys", daemon=True)
    with keyboard.taken_again():
        reader.start()
        try:
            yield True
        finally:
            os.write(told, b"\0")
            reader.join()
            with suppress(OSError, termios.error):  # the terminal may be gone by now
                keyboard.give_back()
            os.close(leave)
            os.close(told)


def _read(terminal: int, leave: int, stop: Callable[[], None]) -> None:
    """Until `leave` can be read, or the terminal is gone."""
    while True:
        with suppress(InterruptedError):
            ready, _, _ = select.select([terminal, leave], [], [])
            if leave in ready:
                return
            if not _in_front(terminal):  # what is typed is the shell's, and reading it would freeze this program
                select.select([leave], [], [], _PAUSE_S)
                continue
            try:
                keys = os.read(terminal, _AT_ONCE)
            except OSError:
                return
            if not keys:
                return
            if not STOPPING.isdisjoint(keys):
                stop()


def _in_front(terminal: int) -> bool:
    """Whether this program, and not a shell that it was put behind, has the terminal."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False


class _Keyboard:
    """Settings of a terminal, as they were and as keys without Enter need them. Raises OSError if it is none of ours.

    Only ever changed by a program in front: one behind would be frozen for it.
    """

    def __init__(self, terminal: int) -> None:
        if not _in_front(terminal):
            raise OSError("the terminal is another's")
        self._terminal = terminal
        self._before = termios.tcgetattr(terminal)

    def take(self) -> None:
        """No echo, and no waiting for Enter; Ctrl-C stays a signal. What was typed before is dropped."""
        settings = termios.tcgetattr(self._terminal)
        settings[3] &= ~(termios.ICANON | termios.ECHO)
        settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
        self._set(settings)

    def give_back(self) -> None:
        """As it was; what was typed since is dropped, and does not reach the shell."""
        self._set(self._before)

    def _set(self, settings: list[object]) -> None:
        if _in_front(self._terminal):
            termios.tcsetattr(self._terminal, termios.TCSAFLUSH, settings)  # type: ignore[arg-type]  # as tcgetattr gave it

    @contextmanager
    def taken_again(self) -> Iterator[None]:
        """While inside, a program that goes on after it was frozen takes the terminal anew."""
        if threading.current_thread() is not threading.main_thread():  # Python delivers signals to no other
            yield
            return

        def again(*_: object) -> None:
            with suppress(OSError, termios.error):
                self.take()

        before = signal.signal(signal.SIGCONT, again)
        try:
            yield
        finally:
            signal.signal(signal.SIGCONT, before)
