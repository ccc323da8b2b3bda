"""The open board's frames over a serial port, of a USB device or a serial line."""

from __future__ import annotations

import select
import time
from collections import deque
from contextlib import suppress
from typing import Final

from serial.tools import list_ports

from firmware_protocol.open_board import HELLO, IDENTITY, Receiver
from inteco_abs.boards.transports.serial_link import TIMEOUT_S, SerialLink
from inteco_abs.errors import BoardError, LinkError, NoAnswerError

_FTDI: Final = 0x0403
"""An RT-DAC/USB has such a chip, and no frames of another logic are sent to it."""
_HELLO_S: Final = 0.1
_MOST_BYTES: Final = 4096


class FramedLine(SerialLink):
    """A link of whole, undamaged frames; damaged ones are dropped, and then missed by their readers.

    Raises BoardError as `SerialLink`.
    """

    keeps_boundaries = True

    def __init__(self, path: str, baud: int, timeout_s: float = TIMEOUT_S) -> None:
        self._receiver = Receiver(from_host=False)
        self._arrived: deque[bytes] = deque()
        super().__init__(path, timeout_s)
        with suppress(OSError, ValueError):  # not every port has every rate; the board then does not answer
            self._port.baudrate = baud

    def read(self, length: int) -> bytes:  # noqa: ARG002  a frame says its own length
        """Receive a frame; NoAnswerError if none comes in time."""
        end = time.monotonic() + self.timeout_s
        while not self._arrived:
            left = end - time.monotonic()
            try:
                if left <= 0.0 or not select.select([self._port], [], [], left)[0]:
                    raise NoAnswerError(f"the board did not answer within {self.timeout_s * 1e3:g} ms")
                data = self._port.read(max(1, min(self._port.in_waiting, _MOST_BYTES)))
            except OSError as error:
                raise LinkError(f"the board is gone: check cable and power ({error})") from error
            self._arrived.extend(self._receiver.feed(data))
        return self._arrived.popleft()

    @staticmethod
    def _seen() -> str:
        ports = [port.device for port in list_ports.comports() if port.vid is not None]
        return f"seen: {', '.join(ports)}" if ports else "no serial port of a USB device"

    def _drain(self, most_s: float) -> None:
        super()._drain(most_s)
        self._receiver.drop()
        self._arrived.clear()


def only_port(baud: int) -> str:
    """Return the path of the only serial port of a USB device at which an open board answers HELLO.

    Ports of FTDI chips are not asked. Raises BoardError unless there is exactly one.
    """
    ports: list[str] = [port.device for port in list_ports.comports() if port.vid is not None and port.vid != _FTDI]
    found = [path for path in ports if _answers(path, baud)]
    if len(found) == 1:
        return found[0]
    if found:
        raise BoardError(f"{len(found)} open boards answer, at {', '.join(found)}: name one, as in open:{found[0]}")
    asked = f"none of {', '.join(ports)} answers" if ports else "no serial port of a USB device"
    raise BoardError(
        f"no open board: {asked}. Is it plugged in and flashed? One behind an FTDI chip or without USB must be named, "
        "as in open:/dev/ttyUSB0"
    )


def _answers(path: str, baud: int) -> bool:
    """Return whether an open board is at this port; nothing changes there."""
    try:
        line = FramedLine(path, baud)
    except BoardError:
        return False
    try:
        line.timeout_s = _HELLO_S
        line.write(HELLO.encode())
        return line.read(0)[1] == IDENTITY.kind
    except LinkError:
        return False
    finally:
        line.close()
