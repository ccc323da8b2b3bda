"""The byte stream of the first RT-DAC/USB, over the serial port of the kernel's `ftdi_sio`."""

from __future__ import annotations

import errno
import os
import select
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

import serial

from firmware_protocol.rtdac_usb import DUMMY
from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.serial_ports import describe_ports, ftdi_ports, set_latency_timer
from inteco_abs.errors import BoardError, LinkError
from inteco_abs.posix import TerminalError, fcntl, grp, require_posix, termios

TIMEOUT_S: Final = 0.010
"""Time-out of an answer or a write: an exchange takes 2 or 3 ms (three full-speed packets, the last after a latency
timer of 1 ms), and a loop that is silent for 50 ms counts as hung."""
QUIET_S: Final = 0.003
"""Silence after which no byte is on its way: latency timer, frame of the bus, and a margin."""
_SLOW_TIMEOUT_S: Final = 0.1
"""Time-out with the chip's default latency timer of 16 ms."""
_MOST_S: Final = 0.010
"""Longest wait for that silence in a run; after it another master reads or writes."""
_MOST_AT_FIRST_S: Final = 0.5
"""Longest wait at opening, when an earlier program may have left full buffers."""
_PSEUDO_TERMINALS: Final = "/dev/pts/"


class SerialLink(Link):
    """A link to the board at the serial port `path`, without message boundaries: an answer has the requested length.

    The port keeps pyserial's 9600 baud: the vendor's library sets none, so the chip works as a FIFO (INFERRED). The
    library's event character 0x3F, which hurries some answers, is set if this user may. Raises BoardError for a missing
    port, no permission, or a port in use.
    """

    keeps_boundaries = False

    def __init__(self, path: str, timeout_s: float = TIMEOUT_S, quiet_s: float = QUIET_S) -> None:
        self._timeout_s = timeout_s
        self._quiet_s = quiet_s
        self._port = _open(path, timeout_s, self._seen)
        self._slow = set_latency_timer(path)
        if self._slow:  # too slow for a loop, but a rescue must wait for its answer
            self.timeout_s = timeout_s
        try:
            self.write(DUMMY)
        except LinkError:
            self.close()
            raise
        self._drain(_MOST_S)

    @property  # the port applies it
    def timeout_s(self) -> float:
        """Time-out of a call, s."""
        return self._timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        if self._slow:
            timeout_s = max(timeout_s, _SLOW_TIMEOUT_S)
        if timeout_s == self._timeout_s:
            return
        self._timeout_s = timeout_s
        with suppress(OSError, TerminalError):  # it may be gone; the next call says so
            self._port.timeout = timeout_s

    def prepare(self, length: int) -> None:  # noqa: ARG002  as below
        """Drop old answers; raises BoardError if the latency timer is too long and could not be set."""
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

    def discard(self, length: int) -> None:  # noqa: ARG002  answers have no boundaries
        """Drop bytes until none arrives for 3 ms, so that the next byte begins an answer."""
        self._drain(_MOST_S)

    def close(self) -> None:
        """Close the port and release its locks."""
        with suppress(OSError):  # it may be gone
            self._port.close()

    @staticmethod
    def _seen() -> str:
        """Describe the ports that may be such a board."""
        return describe_ports(ftdi_ports())

    def _drain(self, most_s: float) -> None:
        end = time.monotonic() + most_s
        with suppress(OSError):  # the next exchange fails
            while time.monotonic() < end and select.select([self._port], [], [], self._quiet_s)[0]:
                self._port.read(max(1, self._port.in_waiting))


def _open(path: str, timeout_s: float, seen: Callable[[], str]) -> Any:
    """Open pyserial's port, raw and exclusive. Raises BoardError."""
    require_posix("a board at a serial port")
    port = None
    try:
        port = serial.Serial(path, timeout=timeout_s, write_timeout=timeout_s, exclusive=True)
        # `exclusive` is advisory; this keeps all programs out, but would close a pseudo-terminal to the guardian after
        # this process has died
        if not os.path.realpath(path).startswith(_PSEUDO_TERMINALS):
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    except (OSError, TerminalError) as error:
        if port is not None:
            port.close()
        raise BoardError(f"{path} cannot be opened: {_why(path, error, seen)}") from error
    return port


def _why(path: str, error: OSError | TerminalError, seen: Callable[[], str]) -> str:
    number = getattr(error, "errno", None)
    if number in {errno.ENOENT, errno.ENXIO, errno.ENODEV}:
        return f"there is no such port; {seen()}"
    if number in {errno.EACCES, errno.EPERM}:
        group = _group(path)
        return f"no permission: its group is {group}; sudo usermod -aG {group} $USER, then log in again"
    if number in {errno.EBUSY, errno.EAGAIN}:
        return "another program has it: one program at a time"
    return f"is it a serial port? ({error})"


def _group(path: str) -> str:
    number = os.stat(path).st_gid  # noqa: PTH116  the user's path, as pyserial takes it
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _gone(error: OSError) -> LinkError:
    """Return the error of a lost port; pyserial has several, most without a number."""
    return LinkError(f"the board is gone: check cable and power ({error})")
