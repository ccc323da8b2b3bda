"""Keys that act without Enter, such as space and q, which stop a run beside Ctrl-C."""

from __future__ import annotations

import os
import select
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from inteco_abs.posix import TerminalError, termios

STOPPING: Final = frozenset(b" qQ")
_AT_ONCE: Final = 64
_PAUSE_S: Final = 0.2


@contextmanager
def stop_keys(
    stop: Callable[[], None], terminal: int = 0, other: Callable[[bytes], None] | None = None
) -> Iterator[bool]:
    """Let `STOPPING` keys call `stop`, and all others `other`, as `pressed_keys`."""

    def handle(keys: bytes) -> None:
        if not STOPPING.isdisjoint(keys):
            stop()
        elif other is not None:
            other(keys)

    with pressed_keys(handle, terminal) as can:
        yield can


@contextmanager
def pressed_keys(handle: Callable[[bytes], None], terminal: int = 0) -> Iterator[bool]:
    """Let keys on `terminal`, a file descriptor, reach `handle` from a thread; yields whether they can.

    They cannot if it is not a terminal, or if the program runs in the background. Leaving restores the terminal's
    settings and drops unread keys. A program that continues after a stop (SIGCONT) sets the terminal up again.
    """
    try:
        keyboard = _Keyboard(terminal)
        keyboard.take()
    except (OSError, TerminalError):  # not a terminal, or closed
        yield False
        return
    leave, leaving = os.pipe()
    reader = threading.Thread(target=_read, args=(terminal, leave, handle), name="keys", daemon=True)
    with keyboard.taken_again():
        reader.start()
        try:
            yield True
        finally:
            os.write(leaving, b"\0")
            reader.join()
            with suppress(OSError, TerminalError):  # the terminal may be gone by now
                keyboard.give_back()
            os.close(leave)
            os.close(leaving)


def _read(terminal: int, leave: int, handle: Callable[[bytes], None]) -> None:
    """Read keys until `leave` can be read or the terminal is gone."""
    while True:
        with suppress(InterruptedError):
            ready, _, _ = select.select([terminal, leave], [], [])
            if leave in ready:
                return
            if not _in_front(terminal):  # keys are the shell's, and reading them would stop this program
                select.select([leave], [], [], _PAUSE_S)
                continue
            try:
                keys = os.read(terminal, _AT_ONCE)
            except OSError:
                return
            if not keys:
                return
            handle(keys)


def _in_front(terminal: int) -> bool:
    """Whether this program is in the terminal's foreground."""
    try:
        return hasattr(os, "tcgetpgrp") and os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False


class _Keyboard:
    """A terminal's settings, as they were and for keys without Enter. Raises OSError in the background.

    Only a program in the foreground changes them: in the background the kernel would stop it.
    """

    def __init__(self, terminal: int) -> None:
        if not _in_front(terminal):
            raise OSError("the program is in the background")
        self._terminal = terminal
        self._before = termios.tcgetattr(terminal)

    def take(self) -> None:
        """Switch echo and waiting for Enter off; Ctrl-C stays a signal. Drops what was typed before."""
        settings = termios.tcgetattr(self._terminal)
        settings[3] &= ~(termios.ICANON | termios.ECHO)
        settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
        self._set(settings)

    def give_back(self) -> None:
        """Restore the settings; drop unread keys, so that the shell does not get them."""
        self._set(self._before)

    def _set(self, settings: list[object]) -> None:
        if _in_front(self._terminal):
            termios.tcsetattr(self._terminal, termios.TCSAFLUSH, settings)  # type: ignore[arg-type]  # as tcgetattr gave it

    @contextmanager
    def taken_again(self) -> Iterator[None]:
        """Take the terminal again after SIGCONT."""
        if threading.current_thread() is not threading.main_thread():  # Python delivers signals to no other
            yield
            return

        def again(*_: object) -> None:
            with suppress(OSError, TerminalError):
                self.take()

        before = signal.signal(signal.SIGCONT, again)
        try:
            yield
        finally:
            signal.signal(signal.SIGCONT, before)
