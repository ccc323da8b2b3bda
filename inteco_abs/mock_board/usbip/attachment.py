"""The transfers of a USB/IP peer that has imported the board, by the peer's sequence numbers."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable
from functools import partial
from typing import Final

from inteco_abs.mock_board.usbip.messages import MalformedError, Submit, Unlink, submit_return, unlink_return
from inteco_abs.mock_board.usbip.usb_descriptors import ENDPOINT_DIRECTION_IN
from inteco_abs.mock_board.usbip.usb_host import Urb, UsbHost

_MOST_IN_FLIGHT: Final = 256


class Attachment:
    """Transfers between `host` and one peer; `send` receives the answers.

    The kernel disconnects on an answer to a transfer that it has given up. So one lock covers both the decision how a
    transfer ends and its answer: after a successful unlink the transfer has no answer.
    """

    def __init__(self, host: UsbHost, device_id: int, send: Callable[[bytes], None]) -> None:
        self._host = host
        self._device_id = device_id
        self._send = send
        self._in_flight: dict[int, Urb] = {}
        self._lock = threading.RLock()

    def handle(self, command: Submit | Unlink) -> None:
        """Execute the peer's command. Raises MalformedError for a command that no kernel sends."""
        if command.device_id != self._device_id:
            raise MalformedError
        if isinstance(command, Unlink):
            self._unlink(command)
        else:
            self._submit(command)

    def end(self) -> None:
        """Cancel all transfers, as the peer has gone."""
        with self._lock:
            abandoned = list(self._in_flight.values())
            self._in_flight.clear()
        for urb in abandoned:
            self._host.cancel(urb)

    def _submit(self, command: Submit) -> None:
        sequence = command.sequence
        urb = Urb(
            command.endpoint | (ENDPOINT_DIRECTION_IN if command.reads else 0),
            partial(self._completed, sequence),
            data=command.data,
            length=command.length if command.reads else 0,
            setup=None if command.endpoint else command.setup,
            short_not_ok=command.short_not_ok,
            zero_packet=command.zero_packet,
        )
        with self._lock:
            if sequence in self._in_flight or len(self._in_flight) >= _MOST_IN_FLIGHT:
                raise MalformedError
            self._in_flight[sequence] = urb
        try:
            self._host.submit(urb)
        except OSError as error:
            urb.status = -(error.errno or errno.EIO)
            self._completed(sequence, urb)

    def _unlink(self, command: Unlink) -> None:
        with self._lock:
            urb = self._in_flight.pop(command.victim, None)
            if urb is not None and self._host.cancel(urb):
                self._send(unlink_return(command.sequence, -errno.ECONNRESET))
                return
            if urb is not None:
                self._answer(command.victim, urb)  # it has ended, but its own thread has not answered yet
            self._send(unlink_return(command.sequence, 0))

    def _completed(self, sequence: int, urb: Urb) -> None:
        with self._lock:
            if self._in_flight.get(sequence) is urb:
                del self._in_flight[sequence]
                self._answer(sequence, urb)

    def _answer(self, sequence: int, urb: Urb) -> None:
        data = urb.received if urb.endpoint & ENDPOINT_DIRECTION_IN else b""
        self._send(submit_return(sequence, urb.status or 0, urb.actual, bytes(data)))
