"""The first RT-DAC/USB's byte stream over a serial port, as the kernel's `ftdi_sio` makes it of the board's chip."""

from __future__ import annotations

import errno
import fcntl
import grp
import os
import select
import termios
import time
from contextlib import suppress
from typing import Any, Final

import serial

from firmware_protocol.rtdac_usb import DUMMY
from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.serial_ports import describe_ports, ftdi_ports, quicken
from inteco_abs.errors import BoardError, LinkError

TIMEOUT_S: Final = 0.010
"""For a whole answer, and for a write: an exchange should take 2 or 3 ms (three full-speed packets, the last of which
waits for a latency timer of 1 ms), and a loop that is silent for 50 ms counts as hung."""
QUIET_S: Final = 0.003
"""Silence after which nothing more is on its way: the latency timer, a frame of the bus, and a margin."""
_SLOW_TIMEOUT_S: Final = 0.1
"""With the chip's own latency timer of 16 ms."""
_MOST_S: Final = 0.010
"""Time for that silence to come in a run; what goes on sending has another master, which reading will tell."""
_MOST_AT_FIRST_S: Final = 0.5
"""The same where a program before this one may have left the buffers full."""
_PSEUDO_TERMINALS: Final = "/dev/pts/"


class SerialLink(Link):
    """The board at the serial port `path`. Bytes have no boundaries here: an answer is as many as were asked for.

    The port keeps pyserial's 9600 baud: the vendor's library sets none, so the chip is a FIFO that has no use for it
    (INFERRED). The event character 0x3F that the library enables, to hurry some answers, is set where this user may.
    Raises BoardError if there is no such port, no permission, or if another program has it.
    """

    keeps_boundaries = False

    def __init__(self, path: str, timeout_s: float = TIMEOUT_S, quiet_s: float = QUIET_S) -> None:
        self._timeout_s = timeout_s
        self._quiet_s = quiet_s
        self._port = _open(path, timeout_s)
        self._slow = quicken(path)
        if self._slow:  # of no use to a loop, but a rescue must wait for such a chip's answer
            self.timeout_s = timeout_s
        try:
            self.write(DUMMY)
        except LinkError:
            self.close()
            raise
        self._drain(_MOST_S)

    @property  # the port has to know it, too
    def timeout_s(self) -> float:
        """How long a call waits for the board, in s."""
        return self._timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        if self._slow:
            timeout_s = max(timeout_s, _SLOW_TIMEOUT_S)
        if timeout_s == self._timeout_s:
            return
        self._timeout_s = timeout_s
        with suppress(OSError, termios.error):  # it may be gone, as the next call says
            self._port.timeout = timeout_s

    def prepare(self, length: int) -> None:  # noqa: ARG002  as below
        """As for any link; raises BoardError if each answer waits for a latency timer that could not be set."""
        if self._slow:
            raise BoardError(self._slow)
        self._drain(_MOST_AT_FIRST_S)

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        try:
            self._port.write(data)
        except serial.SerialTimeoutException:
            raise LinkError(f"the board took no data within {self._timeout_s * 1e3:g} ms") from None
        except OSError as error:
            raise _gone(error) from error

    def read(self, length: int) -> bytes:
        """Receive exactly `length` bytes; LinkError if they are not there in time."""
        try:
            data: bytes = self._port.read(length)
        except OSError as error:
            raise _gone(error) from error
        if len(data) < length:
            came = f"{len(data)} of {length} bytes of an answer came" if data else "the board did not answer"
            raise LinkError(f"{came} within {self._timeout_s * 1e3:g} ms")
        return data

    def exchange(self, first: bytes | bytearray, second: bytes, length: int) -> bytes:
        """Send two messages in one write, which saves a packet, and receive one."""
        self.write(bytes(first) + second)
        return self.read(length)

    def discard(self, length: int) -> None:  # noqa: ARG002  nothing tells where answers begin
        """Drop all that arrives until nothing does for 3 ms, so that the next byte is the first of an answer."""
        self._drain(_MOST_S)

    def close(self) -> None:
        """Let go of the port, and of its locks."""
        with suppress(OSError):  # it may be gone
            self._port.close()

    def _drain(self, most_s: float) -> None:
        end = time.monotonic() + most_s
        with suppress(OSError):  # the next exchange will tell
            while time.monotonic() < end and select.select([self._port], [], [], self._quiet_s)[0]:
                self._port.read(max(1, self._port.in_waiting))


def _open(path: str, timeout_s: float) -> Any:
    """Pyserial's port: raw, and for this program alone. Raises BoardError."""
    port = None
    try:
        port = serial.Serial(path, timeout=timeout_s, write_timeout=timeout_s, exclusive=True)
        # the lock of `exclusive` keeps out who asks for it; this keeps out all, but a pseudo-terminal would stay
        # closed for the guardian when this process has died
        if not os.path.realpath(path).startswith(_PSEUDO_TERMINALS):
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    except (OSError, termios.error) as error:
        if port is not None:
            port.close()
        raise BoardError(f"{path} cannot be opened: {_why(path, error)}") from error
    return port


def _why(path: str, error: OSError | termios.error) -> str:
    number = getattr(error, "errno", None)
    if number in {errno.ENOENT, errno.ENXIO, errno.ENODEV}:
        return f"there is no such port; {describe_ports(ftdi_ports())}"
    if number in {errno.EACCES, errno.EPERM}:
        group = _group(path)
        return f"no permission: its group is {group}; sudo usermod -aG {group} $USER, then log in again"
    if number in {errno.EBUSY, errno.EAGAIN}:
        return "another program has it: one program at a time"
    return f"is it a serial port? ({error})"


def _group(path: str) -> str:
    number = os.stat(path).st_gid  # noqa: PTH116  the path is the user's word, and pyserial's
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _gone(error: OSError) -> LinkError:
    """Pyserial has several errors for it, most without a number; a port that is there fails with a time-out only."""
    return LinkError(f"the board is gone: check cable and power ({error})")
