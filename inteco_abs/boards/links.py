"""Who carries the bytes between host and board."""

from __future__ import annotations

import socket
import struct
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Final, Protocol

from firmware_protocol.local_socket import GREETING
from inteco_abs.errors import BoardError, LinkError

_MOST_WAITING: Final = 4
"""More late answers than this is another program reading along; the next exchange will say so."""

_GREETING_S: Final = 2.0
_TIMEOUT_S: Final = 0.010
"""Far below the window after which a silent loop counts as hung, so that waiting for a lost answer never does."""
_TIMEOUT: Final = struct.pack("ll", 0, round(_TIMEOUT_S * 1e6))  # a timeval


class Link(ABC):
    """A pair of pipes to one board. Messages keep their boundaries, as USB bulk transfers do.

    Both calls raise LinkError when the board cannot be reached, with a text that says what to check.
    """

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
            raise LinkError("the board did not answer: is another program reading from it?")
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
        # the kernel's own time-outs: Python's would cost a system call more at each end
        self._socket.settimeout(None)
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            self._socket.setsockopt(socket.SOL_SOCKET, option, _TIMEOUT)

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        try:
            self._socket.send(data)
        except OSError as error:
            raise LinkError(f"the board cannot be reached: {error.strerror}") from error

    def read(self, length: int) -> bytes:
        """Receive one message; LinkError after 10 ms without one."""
        try:
            data = self._socket.recv(length)
        except BlockingIOError:
            raise LinkError(f"the board did not answer within {_TIMEOUT_S * 1e3:g} ms") from None
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
