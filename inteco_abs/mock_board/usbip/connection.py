"""One peer of the USB/IP server: a stream socket that is never waited for."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from typing import Final

_CHUNK: Final = 1 << 16
_MOST_UNSENT: Final = 32 << 20
_KEEPALIVE: Final = (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3))
"""Seconds, seconds, tries: a computer that went without a word holds the board no longer than this."""


class Connection:
    """What has arrived from the peer, and what it has not taken yet. `send` and `cut` may come from any thread."""

    def __init__(self, peer: socket.socket) -> None:
        self.arrived = bytearray()
        self.closing = False
        """Nothing more is read: it ends when all is sent."""
        self._socket = peer
        self._unsent = bytearray()
        self._lock = threading.Lock()
        peer.setblocking(False)
        if peer.family != socket.AF_UNIX:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for name, value in _KEEPALIVE:
                if hasattr(socket, name):  # not on every system
                    peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    @property
    def unsent(self) -> bool:
        """Whether something waits for the peer to read."""
        return bool(self._unsent)

    def send(self, data: bytes) -> None:
        """Send `data`, now or later; a peer that has stopped reading is cut off."""
        with self._lock:
            self._unsent += data
            self._flush()
            if len(self._unsent) > _MOST_UNSENT:
                self.cut()

    def flush(self) -> None:
        """Send as much as goes without waiting."""
        with self._lock:
            self._flush()

    def receive(self) -> bool:
        """Take what has arrived; False when the peer has gone."""
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return True
        except OSError:
            return False
        self.arrived += data
        return bool(data)

    def cut(self) -> None:
        """Hang up, for the peer an unplug; `close` must follow from who serves it."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()

    def _flush(self) -> None:
        try:
            while self._unsent:
                del self._unsent[: self._socket.send(self._unsent[:_CHUNK])]
        except BlockingIOError:
            return
        except OSError:
            self._unsent.clear()  # the peer has gone, and reading will say so
