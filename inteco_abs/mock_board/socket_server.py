"""Serves a mock board to another process, over a local socket in place of the USB cable."""

from __future__ import annotations

import select
import socket
from contextlib import suppress
from typing import Final

from firmware_protocol.local_socket import GREETING
from inteco_abs.errors import LinkError
from inteco_abs.mock_board.frontend import FrontEnd

_LARGEST: Final = 4096
_CATCH_UP_S: Final = 0.0001
"""Interval at which the rig advances between two exchanges, so that an exchange has little left to compute, and at
which the board's own messages are sent."""
_IDLE_S: Final = 0.01


class SocketServer:
    """Serves one host at a time at `path`, as a USB interface does, and disconnects others.

    Outputs stay when a host leaves, as on every known RT-DAC board.
    """

    def __init__(self, front_end: FrontEnd, path: str) -> None:
        self._front_end = front_end
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(path)
        self._listener.listen(4)
        self._host: socket.socket | None = None

    @property
    def busy(self) -> bool:
        """Whether a host is connected."""
        return self._host is not None

    def step(self) -> None:
        """Serve once, after a short wait."""
        host, catch_up = self._host, self._front_end.device.catch_up
        waiting: list[socket.socket] = [self._listener] if host is None else [host, self._listener]
        ready, _, _ = select.select(waiting, [], [], _IDLE_S if host is None else _CATCH_UP_S)
        if host is not None and host in ready:
            self._serve(host)  # first: a host that has left makes room for the next
        if self._listener in ready:
            self._accept()
        if not ready:
            catch_up()
            if self._host is not None:
                self._send_waiting(self._host)

    def close(self) -> None:
        """Disconnect the host and stop listening."""
        if self._host is not None:
            self._host.close()
        self._listener.close()

    def _serve(self, host: socket.socket) -> None:
        try:
            data = host.recv(_LARGEST)
        except OSError:
            data = b""
        try:
            if data:
                self._answer(host, data)
                return
        except LinkError:
            pass  # unplugged: the host sees a lost connection
        host.close()
        self._host = None

    def _answer(self, host: socket.socket, data: bytes) -> None:
        self._front_end.bulk_out(data)
        self._send_waiting(host)

    def _send_waiting(self, host: socket.socket) -> None:
        while answer := self._front_end.bulk_in(_LARGEST):
            try:
                host.send(answer, socket.MSG_DONTWAIT)
            except OSError:
                break  # it does not read, or is gone: the next step finds out

    def _accept(self) -> None:
        host, _ = self._listener.accept()
        if self._host is None:
            with suppress(OSError):
                host.send(GREETING)
                self._host = host
                return
        host.close()
