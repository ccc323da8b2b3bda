"""Cuts messages of a first-generation board out of the byte stream of its FTDI chip.

Sources: docs/facts/boards.md#first-generation for the messages, docs/facts/usb.md#ftdi-chip for the chip's packets of
64 bytes, each of which begins with two bytes of status.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from firmware_protocol.rtdac_usb import DUMMY, FRAME_BYTES, READ_REQUEST, SEND_AND_READ_COMMAND, SEND_COMMAND
from inteco_abs.wire.capture import Record, RecordKind

_OUT, _IN = 0x02, 0x81
"""Endpoints of the chip."""
_PACKET_BYTES: Final = 64
_STATUS_BYTES: Final = 2
_MARK: Final = 0x80
"""Bit of a byte to the board that begins a message."""
_SHORT: Final = (DUMMY[0], READ_REQUEST[0])
_LONG: Final = (SEND_COMMAND, SEND_AND_READ_COMMAND)


class MessageCutter:
    """Joins and cuts the bytes of both directions; a message has the time of the transfer that completed it.

    Other bytes, such as those that program the FPGA, are left out with a warning.
    """

    def __init__(self) -> None:
        self._out = bytearray()
        self._in = bytearray()
        self._awaited = False
        self._records: list[Record] = []

    def messages(self, transfers: Iterable[Record]) -> list[Record]:
        """Return the capture with whole messages in place of transfers."""
        for record in transfers:
            if record.kind is RecordKind.OUT:
                self._out += record.data
                self._cut_out(record.t_s)
            elif record.kind is RecordKind.IN:
                self._in += without_status(record.data)
                self._cut_in(record.t_s)
            else:
                self._records.append(record)
        last_s = self._records[-1].t_s if self._records else 0.0
        self._drop(last_s, self._out, "to the board at the end of the capture")
        self._drop(last_s, self._in, "from the board at the end of the capture")
        return self._records

    def _cut_out(self, t_s: float) -> None:
        while self._out:
            command = self._out[0]
            if command in _SHORT:
                self._emit(t_s, 1)
            elif command in _LONG:
                marked = _next_mark(self._out, 1)
                if marked < min(FRAME_BYTES, len(self._out)):
                    self._drop(t_s, self._out, "of a message to the board that another one interrupts", marked)
                elif len(self._out) < FRAME_BYTES:
                    return
                else:
                    self._emit(t_s, FRAME_BYTES)
            else:
                self._drop(t_s, self._out, "to the board before a command", _next_known(self._out))

    def _emit(self, t_s: float, length: int) -> None:
        message = bytes(self._out[:length])
        del self._out[:length]
        if message[0] in {READ_REQUEST[0], SEND_AND_READ_COMMAND}:
            # the vendor's library drops what an earlier answer has left
            self._drop(t_s, self._in, "from the board before a request")
            self._awaited = True
        self._records.append(Record(t_s, RecordKind.OUT, _OUT, message))

    def _cut_in(self, t_s: float) -> None:
        if self._awaited and len(self._in) >= FRAME_BYTES:
            self._records.append(Record(t_s, RecordKind.IN, _IN, bytes(self._in[:FRAME_BYTES])))
            del self._in[:FRAME_BYTES]
            self._awaited = False

    def _drop(self, t_s: float, stream: bytearray, what: str, length: int | None = None) -> None:
        count = len(stream) if length is None else length
        del stream[:count]
        if count:
            self._records.append(Record(t_s, RecordKind.WARNING, text=f"{count} bytes {what} are left out"))


def whole_messages(transfers: Iterable[Record]) -> list[Record]:
    """Return the capture with whole messages in place of transfers."""
    return MessageCutter().messages(transfers)


def without_status(transfer: bytes) -> bytes:
    """Return the payload of a transfer from the chip."""
    return b"".join(transfer[at + _STATUS_BYTES : at + _PACKET_BYTES] for at in range(0, len(transfer), _PACKET_BYTES))


def _next_mark(stream: bytearray, start: int) -> int:
    """Return the index from `start` on that begins a message; the length if there is none."""
    return next((at for at in range(start, len(stream)) if stream[at] & _MARK), len(stream))


def _next_known(stream: bytearray) -> int:
    known = (*_SHORT, *_LONG)
    return next((at for at in range(1, len(stream)) if stream[at] in known), len(stream))
