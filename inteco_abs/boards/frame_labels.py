"""Names the words of a captured frame by the protocol's tables."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from firmware_protocol.fields import BYTE_BITS, FrameTable, Layout, Logic, Value
from inteco_abs.errors import ConfigError, ConfigIssue, near_match

UNKNOWN: Final = "unknown"
COMMAND: Final = "command"


class MessageRole(StrEnum):
    """Role of a message."""

    SEND = "SEND"
    REQUEST = "READ request"
    READ = "READ answer"
    OTHER = "other"


@dataclass(frozen=True)
class BoardProtocol:
    """Recognises the messages of one board, and names their words."""

    board: str
    title: str
    logic_version: int | None
    """Version of the tables; None: not published."""
    logic: Logic
    settings: Mapping[str, object]
    """Keys of [board] and their values in a profile for this protocol."""
    replays: bool = True
    """Whether a driver that repeats a capture's commands writes the same messages."""

    @property
    def send(self) -> FrameTable:
        """Table of the host's frames."""
        return self.logic.send

    @property
    def read(self) -> FrameTable:
        """Table of the board's frames."""
        return self.logic.read

    def role_out(self, message: bytes) -> MessageRole:
        """Return the role of a message from the host."""
        if message == self.logic.request:
            return MessageRole.REQUEST
        if len(message) == self.send.size and words_of(self.send, message)[0] == self.send.command:
            return MessageRole.SEND
        return MessageRole.OTHER

    def role_in(self, message: bytes) -> MessageRole:
        """Return the role of a message from the board."""
        return MessageRole.READ if len(message) == self.read.size else MessageRole.OTHER

    def identity_in(self, answer: bytes) -> dict[str, Value] | None:
        """Return version and name of the logic if the board's message has them. Raises ProtocolError."""
        if self.role_in(answer) is not MessageRole.READ:
            return None
        return self.logic.header.decode_some(answer, ("logic_version", "application_name"))

    def fields(self, names: Iterable[str]) -> frozenset[str]:
        """Return the names as a set; raises ConfigError for one in neither table."""
        known = self.send.fields.keys() | self.read.fields.keys()
        chosen = frozenset(names)
        for name in sorted(chosen - known):
            raise ConfigError([ConfigIssue("field", f"{self.title} has no field {name!r}{near_match(name, known)}")])
        return chosen


def words_of(table: FrameTable, frame: bytes) -> Sequence[int]:
    """Return the words of a frame of the right size, unchecked."""
    return frame if table.word_bits == BYTE_BITS else struct.unpack(f"<{len(frame) // 2}H", frame)


def label(table: FrameTable, word: int) -> str:
    """Return a place in the notation of the protocol reference: `w22` is word 22, `b21` data byte 21."""
    return f"{'b' if table.word_bits == BYTE_BITS else 'w'}{word - table.data_from}"


def byte_offset(table: FrameTable, word: int) -> int:
    """Return the byte at which the word begins in its message."""
    return word * table.word_bits // BYTE_BITS


def names_at(table: FrameTable, word: int, mask: int) -> tuple[str, ...]:
    """Return the fields with bits of `mask` in `word` of the frame; `unknown` for other bits."""
    if table.command is not None and word == 0:
        return (COMMAND,)
    names, owned = [], 0
    for name, (_, layout) in table.fields.items():
        bits = mask_of(layout, word - table.data_from)
        owned |= bits
        if bits & mask:
            names.append(name)
    return (*names, UNKNOWN) if mask & ~owned else tuple(names)


def mask_of(layout: Layout, word: int) -> int:
    """Return the bits of data word `word` that carry the layout."""
    mask = 0
    for part in layout:
        if part.word == word:
            mask |= part.mask << part.low
    return mask


def masks_of(table: FrameTable, names: Iterable[str]) -> dict[int, int]:
    """Return the bits of the named fields by word of the frame; skips fields that the table lacks."""
    masks: dict[int, int] = {}
    for name in names:
        if name in table.fields:
            for part in table.fields[name][1]:
                word = part.word + table.data_from
                masks[word] = masks.get(word, 0) | part.mask << part.low
    return masks
