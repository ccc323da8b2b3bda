"""A connection of the USB/IP server: a non-blocking stream socket with buffers."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from typing import Final

_CHUNK: Final = 1 << 16
_MOST_UNSENT: Final = 32 << 20
_KEEPALIVE: Final = (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3))
"""Seconds, seconds, tries: after 25 s the server drops a computer that has vanished."""


class Connection:
    """Buffers of received and unsent bytes of one peer. `send` and `cut` may be called from any thread."""

    def __init__(self, peer: socket.socket) -> None:
        self.arrived = bytearray()
        self.closing = False
        """Whether to close once all is sent; nothing more is read."""
        self._socket = peer
        self._unsent = bytearray()
        self._lock = threading.Lock()
        peer.setblocking(False)
        if peer.family in {socket.AF_INET, socket.AF_INET6}:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for name, value in _KEEPALIVE:
                if hasattr(socket, name):  # not on every system
                    peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    def fileno(self) -> int:
        """Return the descriptor for `select`."""
        return self._socket.fileno()

    @property
    def unsent(self) -> bool:
        """Whether bytes wait for the peer."""
        return bool(self._unsent)

    def send(self, data: bytes) -> None:
        """Send `data`, now or later; disconnect a peer that has stopped reading."""
        with self._lock:
            self._unsent += data
            self._flush()
            if len(self._unsent) > _MOST_UNSENT:
                self.cut()

    def flush(self) -> None:
        """Send as much as possible without waiting."""
        with self._lock:
            self._flush()

    def receive(self) -> bool:
        """Receive what has arrived; return False if the peer has gone."""
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return True
        except OSError:
            return False
        self.arrived += data
        return bool(data)

    def cut(self) -> None:
        """Disconnect, for the peer an unplug; the serving thread must call `close` afterwards."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _flush(self) -> None:
        try:
            while self._unsent:
                del self._unsent[: self._socket.send(self._unsent[:_CHUNK])]
        except BlockingIOError:
            return
        except OSError:
            self._unsent.clear()  # the peer has gone; the next `receive` returns False
