"""A link that answers from a capture, and compares the written messages with the captured ones."""

from __future__ import annotations

from collections import deque
from typing import Final, NamedTuple

from firmware_protocol.fields import FrameTable
from inteco_abs.boards import MessageRole, byte_offset, label, masks_of, names_at, protocol_of, words_of
from inteco_abs.boards.transports.links import Link
from inteco_abs.errors import CaptureError, LinkError
from inteco_abs.wire.capture import Capture, Record, RecordKind

MOST_DIFFERENCES: Final = 10_000
"""Limit of the list; further differences are only counted."""


class FrameDifference(NamedTuple):
    """A word that differs from the captured message, or a whole message out of order."""

    message: int
    """Number of the written message, from 1."""
    place: str
    """The word, as in `w22`; `order`, `length` or `message` for a whole message."""
    byte_offset: int
    fields: tuple[str, ...]
    captured: str
    ours: str

    def __str__(self) -> str:
        named = f" ({', '.join(self.fields)})" if self.fields else ""
        return (
            f"message {self.message}, {self.place} at byte {self.byte_offset}{named}: "
            f"captured {self.captured}, ours {self.ours}"
        )


class CaptureLink(Link):
    """A link that plays a capture back: answers and failures come in the captured order.

    The n-th SEND frame is compared with the captured n-th, other messages with those of their role; the first message
    in another order than the captured one is a difference, too. `differences` collects them; if `strict`, the first one
    raises CaptureError as well. `numbering` is a field that numbers the frames, such as `pwm7_prescaler`: it is not
    compared, and answers carry the written number in place of the captured one, as the board's would. Raises LinkError
    at the end of the capture.
    """

    def __init__(self, capture: Capture, *, strict: bool = False, numbering: str = "") -> None:
        self.differences: list[FrameDifference] = []
        self.differing = 0
        """Number of differences, including those beyond the list."""
        self._capture = capture
        self._protocol = protocol_of(capture.board)
        self._strict = strict
        names = self._protocol.fields([numbering] if numbering else [])
        self._numbering = _Numbering(self._protocol.send, self._protocol.read, numbering) if numbering else None
        self._ignored = masks_of(self._protocol.send, names)
        self._queues: dict[MessageRole | None, deque[tuple[int, Record]]] = {}  # None: answers and their failures
        for index, record in enumerate(capture.records):
            if record.kind in {RecordKind.OUT, RecordKind.IN, RecordKind.ERROR}:
                self._queues.setdefault(self._queue_of(record), deque()).append((index, record))
        self._written = 0
        self._newest_s = 0.0
        self._furthest = -1
        self._ahead = False  # whether a later record has been used already
        self._ordered = True
        self._closed = False

    @property
    def left(self) -> int:
        """Number of unused captured messages and failures."""
        return sum(map(len, self._queues.values()))

    def now_ns(self) -> int:
        """Return the time of the newest used record, ns since the capture began."""
        return round(self._newest_s * 1e9)

    def write(self, data: bytes | bytearray) -> None:
        """Compare one message with the captured one."""
        ours = bytes(data)
        self._written += 1
        role = self._protocol.role_out(ours)
        index, captured = self._next(role, role)
        found = [*self._order(index, role), *self._compare(captured.data, ours)]
        if self._numbering is not None and role is MessageRole.SEND:
            self._numbering.read_from(ours)
        first = self.differing == 0
        self.differing += len(found)
        self.differences += found[: MOST_DIFFERENCES - len(self.differences)]
        if found and first and self._strict:  # once: the messages that make the board safe must pass
            raise CaptureError(f"{self._capture.name}: {found[0]}")
        if captured.kind is RecordKind.ERROR:
            raise LinkError(f"as captured: {captured.text}")

    def read(self, length: int) -> bytes:
        """Return the next captured answer."""
        _, captured = self._next(None, "answers")
        if captured.kind is RecordKind.ERROR:
            raise LinkError(f"as captured: {captured.text}")
        if self._numbering is not None and self._protocol.role_in(captured.data) is MessageRole.READ:
            return self._numbering.put_into(captured.data)[:length]
        return captured.data[:length]

    def discard(self, length: int) -> None:
        """Do nothing: a capture has no dropped answers."""

    def close(self) -> None:
        """Stop answering."""
        self._closed = True

    def _queue_of(self, record: Record) -> MessageRole | None:
        is_answer = record.kind is RecordKind.IN or (record.kind is RecordKind.ERROR and record.of != "out")
        return None if is_answer else self._protocol.role_out(record.data)

    def _next(self, queue: MessageRole | None, wanted: str) -> tuple[int, Record]:
        if self._closed:
            raise LinkError("the capture is closed")
        waiting = self._queues.get(queue)
        if not waiting:
            raise LinkError(
                f"{self._capture.name} has no more {wanted}: it has {self._capture.messages} messages, "
                f"{self._written} were written in this replay"
            )
        index, record = waiting.popleft()
        self._newest_s = max(self._newest_s, record.t_s)
        self._ahead = self._furthest > index
        self._furthest = max(self._furthest, index)
        return index, record

    def _order(self, index: int, role: MessageRole) -> list[FrameDifference]:
        if not (self._ahead and self._ordered):
            return []
        self._ordered = False
        first_line = 2  # after the header
        captured, ours = f"line {index + first_line}, a {role}", f"only after line {self._furthest + first_line}"
        return [FrameDifference(self._written, "order", 0, (), captured, ours)]

    def _compare(self, captured: bytes, ours: bytes) -> list[FrameDifference]:
        table = self._protocol.send
        if len(captured) != len(ours):
            return [FrameDifference(self._written, "length", 0, (), f"{len(captured)} bytes", f"{len(ours)} bytes")]
        if captured == ours:
            return []
        if self._protocol.role_out(ours) is not MessageRole.SEND:
            return [FrameDifference(self._written, "message", 0, (), captured.hex(), ours.hex())]
        return [
            FrameDifference(
                self._written,
                label(table, word),
                byte_offset(table, word),
                names_at(table, word, mask),
                f"0x{then:04X}",
                f"0x{now:04X}",
            )
            for word, mask, then, now in differing_words(table, captured, ours, self._ignored)
        ]


def differing_words(
    table: FrameTable, first: bytes, second: bytes, ignored: dict[int, int]
) -> list[tuple[int, int, int, int]]:
    """Return word, differing bits and both values for each word in which two frames of one size differ."""
    both = enumerate(zip(words_of(table, first), words_of(table, second), strict=True))
    return [(word, mask, a, b) for word, (a, b) in both if (mask := (a ^ b) & ~ignored.get(word, 0))]


class _Numbering:
    """Copies the number of the newest written SEND frame into captured answers, as a board echoes it."""

    def __init__(self, send: FrameTable, read: FrameTable, name: str) -> None:
        if name not in send.fields or name not in read.fields:
            raise CaptureError(f"{name} cannot number frames: it must be a field of both {send.title} and {read.title}")
        self._send, self._read, self._name = send, read, name
        self._number: int | None = None

    def read_from(self, frame: bytes) -> None:
        self._number = int(self._send.decode_some(frame, [self._name])[self._name])

    def put_into(self, frame: bytes) -> bytes:
        if self._number is None:
            return frame
        words = self._read.words(frame)
        for part in self._read.fields[self._name][1]:
            at = part.word + self._read.data_from
            words[at] = words[at] & ~(part.mask << part.low) | (self._number >> part.shift & part.mask) << part.low
        return self._read.pack(words)
