"""A mock board at a pseudo-terminal, which needs no root, kernel module or USB bus."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from inteco_abs.errors import BoardError, describe_disk
from inteco_abs.mock_board.frontend import Stream
from inteco_abs.posix import require_posix, tty

_CHUNK: Final = 4096
_CATCH_UP_S: Final = 0.001
"""Longest interval at which the rig advances while a host is active."""
_IDLE_S: Final = 0.01
_BUSY_S: Final = 1.0
_TERMINALS: Final = "/dev/pts/"


class PtyServer:
    """Serves `stream` at a new pseudo-terminal: call `serve`, which ends at `close`, or `step` in a loop.

    Outputs stay when a host leaves, as on every known RT-DAC board. The host's end stays open here too, so that it
    keeps its raw mode between two hosts and never looks unplugged. `link`, if given, becomes a symbolic link to it.
    Raises BoardError if that cannot be made.
    """

    def __init__(self, stream: Stream, link: Path | None = None) -> None:
        require_posix("a mock board at a serial port", "serve it with --usbip")
        self.lost_bytes = 0
        """Bytes of answers that did not fit into the buffer."""
        self._stream = stream
        self._link = link
        self._closed = False
        self._busy_until_s = 0.0
        self._board, self._host = os.openpty()
        tty.setraw(self._host)
        os.set_blocking(self._board, False)
        self.name = os.ttyname(self._host)
        if link is not None:
            try:
                _point(link, self.name)
            except BoardError:
                self.hang_up()
                raise

    def serve(self, each_step: Callable[[], None] = lambda: None) -> None:
        """Serve until `close` or an exception; then remove the port, which for its host is an unplug.

        Calls `each_step` some hundred times a second.
        """
        try:
            while not self._closed:
                self.step()
                each_step()
        finally:
            self.hang_up()

    def close(self) -> None:
        """End `serve`, from any thread or signal handler."""
        self._closed = True

    def step(self) -> None:
        """Serve once, after a short wait."""
        now, device = time.monotonic(), self._stream.front_end.device
        wait_s = _CATCH_UP_S if now < self._busy_until_s else _IDLE_S
        if device.due_ns >= 0:
            wait_s = min(wait_s, max(0.0, device.due_ns * 1e-9 - now))
        if select.select([self._board], [], [], wait_s)[0]:
            self._busy_until_s = now + _BUSY_S
            self._answer(self._stream.feed(os.read(self._board, _CHUNK)))
        device.catch_up()
        self._answer(self._stream.feed(b""))  # what the board sends by itself

    def _answer(self, answer: bytes) -> None:
        sent = 0
        with suppress(BlockingIOError):
            while sent < len(answer):
                sent += os.write(self._board, answer[sent:])
        self.lost_bytes += len(answer) - sent

    def hang_up(self) -> None:
        """Remove the port."""
        if self._link is not None and self._link.is_symlink() and str(self._link.readlink()) == self.name:
            self._link.unlink()
        os.close(self._board)
        os.close(self._host)


def _point(link: Path, name: str) -> None:
    """Make `link` a symbolic link to the terminal `name`; replaces one of an earlier board."""
    try:
        if link.is_symlink() and str(link.readlink()).startswith(_TERMINALS):
            link.unlink()
        link.symlink_to(name)
    except OSError as error:
        raise BoardError(f"{link}: no symbolic link to {name} can be made there: {describe_disk(error)}") from error
