"""Who carries the bytes between host and board."""

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
"""Longest wait for an answer: far below the window after which a silent loop counts as hung, so that waiting for a lost
answer never does."""
_MOST_WAITING: Final = 32
"""More late answers than a stall leaves that a run survives: another program reads along, the next exchange says so."""
_GREETING_S: Final = 2.0


class Link(ABC):
    """A pair of pipes to one board. Messages keep their boundaries, as USB bulk transfers do.

    Both calls raise LinkError when the board cannot be reached, with a text that says what to check.
    """

    timeout_s: float = PATIENCE_S
    """How long a call waits for the board, in s. May be set between two calls; links to what answers at once ignore
    it."""
    engines: tuple[str, ...] = ()
    """Ways to move an exchange's transfers that this link can choose from, the usual one first; empty if it has none
    to choose from."""
    engine: str = ""
    """The one in use; may be set between two calls."""
    keeps_boundaries: bool = True
    """Whether a read begins with the first byte of a message, whatever came before."""

    @abstractmethod
    def write(self, data: bytes | bytearray) -> None:
        """Send one message to the board; `data` may change once the call has returned."""

    @abstractmethod
    def read(self, length: int) -> bytes:
        """Receive one message of at most `length` bytes."""

    def exchange(self, first: bytes | bytearray, second: bytes, length: int) -> bytes:
        """Send two messages and receive one; links that can hand them over together do."""
        self.write(first)
        self.write(second)
        return self.read(length)

    @abstractmethod
    def close(self) -> None:
        """Let go of the board. Writes nothing; may be called twice."""

    def discard(self, length: int) -> None:
        """Drop messages of at most `length` bytes that the board has sent and nobody waits for any more."""
        with suppress(LinkError):
            for _ in range(_MOST_WAITING):
                self._read_waiting(length)

    def _read_waiting(self, length: int) -> bytes:
        """Receive a message that has arrived by now; links that need not wait for it as long as `read` do not."""
        return self.read(length)

    def prepare(self, length: int) -> None:
        """Drop what a program before this one has left; called before the board is identified, not in a rescue.

        Raises BoardError for a link that is of no use to a loop, with what to do about it.
        """
        self.discard(length)


Wrap = Callable[[Link], Link]
"""Puts something around a link, such as a recording."""


class BulkDevice(Protocol):
    """The board's side of a pair of bulk endpoints."""

    def bulk_out(self, data: bytes | bytearray) -> None:
        """What the host writes."""
        ...

    def bulk_in(self, length: int) -> bytes:
        """What the host gets; empty stands for a time-out."""
        ...


class InProcessLink(Link):
    """A device model in this process, by direct calls."""

    def __init__(self, device: BulkDevice) -> None:
        self._device: BulkDevice | None = device

    def write(self, data: bytes | bytearray) -> None:
        """Hand one message to the device."""
        self._reach().bulk_out(data)

    def read(self, length: int) -> bytes:
        """Next answer of the device."""
        data = self._reach().bulk_in(length)
        if not data:
            raise NoAnswerError("the board did not answer: is another program reading from it?")
        return data

    def close(self) -> None:
        """Let go of the device."""
        self._device = None

    def _reach(self) -> BulkDevice:
        if self._device is None:
            raise LinkError("the link to the board is closed")
        return self._device


class SocketLink(Link):
    """A board's process on this computer, by a local socket that keeps message boundaries.

    One host at a time, as with a USB interface: the board's process greets the one that has it and hangs up on all
    others. Raises BoardError if it is not there or has another host.
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

    @property  # the kernel has to know it, too
    def timeout_s(self) -> float:
        """How long a call waits for the board, in s."""
        return self._timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        if timeout_s == self._timeout_s:
            return
        self._timeout_s = timeout_s
        # the kernel's own time-outs: Python's would cost a system call more at each end
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
            raise LinkError("the board hung up")
        return data

    def close(self) -> None:
        """Hang up; the board may then have another host."""
        self._socket.close()

    def _read_waiting(self, length: int) -> bytes:
        try:
            return self._socket.recv(length, socket.MSG_DONTWAIT)
        except OSError as error:
            raise LinkError(f"nothing has arrived: {error.strerror}") from error
