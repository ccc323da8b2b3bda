"""Links that carry messages between host and board."""

from __future__ import annotations

import socket
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Final, Protocol

from firmware_protocol.local_socket import GREETING
from inteco_abs.errors import BoardError, LinkError, NoAnswerError

PATIENCE_S: Final = 0.010
"""Longest wait for an answer, far below the silence after which a loop counts as hung."""
_MOST_WAITING: Final = 32
"""More late answers than a stall leaves that a run survives."""
_GREETING_S: Final = 2.0


class Link(ABC):
    """A link to one board. Messages keep their boundaries, as in USB bulk transfers.

    `write` and `read` raise LinkError when the board cannot be reached, with what to check.
    """

    timeout_s: float = PATIENCE_S
    """Time-out of a call, s; may be set between two calls. Links to an in-process board ignore it."""
    engines: tuple[str, ...] = ()
    """Available ways to move an exchange's transfers, the usual one first; empty: no choice."""
    engine: str = ""
    """The engine in use; may be set between two calls."""
    keeps_boundaries: bool = True
    """Whether every read begins with the first byte of a message."""

    @abstractmethod
    def write(self, data: bytes | bytearray) -> None:
        """Send one message; `data` may change after the call."""

    @abstractmethod
    def read(self, length: int) -> bytes:
        """Receive one message of at most `length` bytes."""

    def exchange(self, first: bytes | bytearray, second: bytes, length: int) -> bytes:
        """Send two messages and receive one; some links hand them over together."""
        self.write(first)
        self.write(second)
        return self.read(length)

    @abstractmethod
    def close(self) -> None:
        """Close the link without writing; may be called twice."""

    def discard(self, length: int) -> None:
        """Drop old answers of at most `length` bytes."""
        with suppress(LinkError):
            for _ in range(_MOST_WAITING):
                self._read_waiting(length)

    def _read_waiting(self, length: int) -> bytes:
        """Receive a message that has arrived; some links wait less for it than `read`."""
        return self.read(length)

    def prepare(self, length: int) -> None:
        """Drop an earlier program's answers; called before the board is identified, not in a rescue.

        Raises BoardError for a link that a loop cannot use, with what to do.
        """
        self.discard(length)


Wrap = Callable[[Link], Link]
"""Wraps a link, such as in a recording."""


class BulkDevice(Protocol):
    """The board's side of a pair of bulk endpoints."""

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Take a message of the host."""
        ...

    def bulk_in(self, length: int) -> bytes:
        """Return the next answer; empty for a time-out."""
        ...


class InProcessLink(Link):
    """A link to a device model in this process, by direct calls."""

    def __init__(self, device: BulkDevice) -> None:
        self._device: BulkDevice | None = device

    def write(self, data: bytes | bytearray) -> None:
        """Pass one message to the device."""
        self._reach().bulk_out(data)

    def read(self, length: int) -> bytes:
        """Return the device's next answer."""
        data = self._reach().bulk_in(length)
        if not data:
            raise NoAnswerError("the board did not answer: is another program reading from it?")
        return data

    def close(self) -> None:
        """Close the link."""
        self._device = None

    def _reach(self) -> BulkDevice:
        if self._device is None:
            raise LinkError("the link to the board is closed")
        return self._device


class SocketLink(Link):
    """A link to a mock board's process, by a local socket that keeps message boundaries.

    The board accepts one host at a time, as a USB interface does. Raises BoardError if it is missing or has another
    host.
    """

    def __init__(self, path: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.settimeout(_GREETING_S)
            self._socket.connect(path)
            greeting = self._socket.recv(len(GREETING))
        except OSError as error:
            self._socket.close()
            raise BoardError(f"no board at {path}: {error.strerror or error}") from error
        if greeting != GREETING:
            self._socket.close()
            raise BoardError(f"the board at {path} has another host: one program at a time")
        self._socket.settimeout(None)
        self._timeout_s = 0.0
        self.timeout_s = PATIENCE_S

    @property  # the kernel applies it
    def timeout_s(self) -> float:
        """Time-out of a call, s."""
        return self._timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        if timeout_s == self._timeout_s:
            return
        self._timeout_s = timeout_s
        # the kernel's time-outs: Python's would cost one more system call at each end
        timeval = struct.pack("ll", int(timeout_s), round(timeout_s % 1.0 * 1e6))
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            self._socket.setsockopt(socket.SOL_SOCKET, option, timeval)

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        try:
            self._socket.send(data)
        except OSError as error:
            raise LinkError(f"the board cannot be reached: {error.strerror}") from error

    def read(self, length: int) -> bytes:
        """Receive one message; LinkError if none comes in time."""
        try:
            data = self._socket.recv(length)
        except BlockingIOError:
            raise NoAnswerError(f"the board did not answer within {self._timeout_s * 1e3:g} ms") from None
        except OSError as error:
            raise LinkError(f"the board cannot be reached: {error.strerror}") from error
        if not data:
            raise LinkError("the board closed the connection")
        return data

    def close(self) -> None:
        """Close the connection; the board then accepts another host."""
        self._socket.close()

    def _read_waiting(self, length: int) -> bytes:
        try:
            return self._socket.recv(length, socket.MSG_DONTWAIT)
        except OSError as error:
            raise LinkError(f"nothing has arrived: {error.strerror}") from error
