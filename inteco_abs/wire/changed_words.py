"""Finds the words that changed during a capture, to identify an unknown word by moving one slider."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import reduce
from itertools import pairwise
from operator import or_
from typing import Final, NamedTuple

from firmware_protocol.fields import FrameTable
from inteco_abs.boards import (
    UNKNOWN,
    BoardProtocol,
    MessageRole,
    byte_offset,
    label,
    masks_of,
    names_at,
    protocol_of,
    words_of,
)
from inteco_abs.wire.capture import Capture, RecordKind
from inteco_abs.wire.playback import differing_words

_RESTLESS: Final = 0.5
"""A word that changes in a larger share of the steps is restless, such as a counter."""
_FEWEST_STEPS: Final = 8
"""Fewest steps in which a word can be restless."""


class FrameColumns(NamedTuple):
    """All frames of one direction in words, with their times."""

    table: FrameTable
    times_s: Sequence[float]
    words: Sequence[Sequence[int]]


class ChangedWord(NamedTuple):
    """A word with more than one value."""

    direction: str
    """SEND or READ."""
    word: str
    byte_offset: int
    bits: int
    """Mask of the bits that changed."""
    minimum: int
    maximum: int
    distinct: int
    """Number of different values."""
    changes: int
    """Number of steps between frames in which it changed."""
    alone: float
    """Share of these steps in which only restless words changed besides, 0..1."""
    restless: bool
    """Whether it changed in most steps, as counters and frame numbers do."""
    course: str
    """"rises" or "falls" if it went one way only, modulo its size; else "both ways"."""
    first_s: float
    last_s: float
    fields: tuple[str, ...]
    """Names in the tables; "unknown" for other bits."""


def frame_columns(capture: Capture, role: MessageRole) -> FrameColumns:
    """Return the SEND frames or READ answers of the capture. Raises ConfigError for a board without tables."""
    protocol = protocol_of(capture.board)
    table = protocol.send if role is MessageRole.SEND else protocol.read
    found = [record for record in capture.records if _role(protocol, record.kind, record.data) is role]
    return FrameColumns(table, [record.t_s for record in found], [words_of(table, record.data) for record in found])


def changed_words(capture: Capture) -> list[ChangedWord]:
    """Return the changed words, SEND first; in each direction the likeliest effect of a hand movement comes first.

    These are words that changed alone, unknown before named ones, restless ones last.
    """
    return [
        word
        for direction, role in (("SEND", MessageRole.SEND), ("READ", MessageRole.READ))
        for word in _ranked(direction, frame_columns(capture, role))
    ]


def _role(protocol: BoardProtocol, kind: RecordKind, data: bytes) -> MessageRole | None:
    if kind is RecordKind.OUT:
        return protocol.role_out(data)
    return protocol.role_in(data) if kind is RecordKind.IN else None


def _ranked(direction: str, frames: FrameColumns) -> list[ChangedWord]:
    columns = {word: values for word, values in enumerate(zip(*frames.words, strict=True)) if len(set(values)) > 1}
    steps = {word: _steps(values) for word, values in columns.items()}
    count = len(frames.words) - 1
    restless = {word for word, at in steps.items() if count >= _FEWEST_STEPS and len(at) > _RESTLESS * count}
    moving = Counter(step for word, at in steps.items() if word not in restless for step in at)
    found = []
    for word, values in columns.items():
        at, own = steps[word], int(word not in restless)
        bits = reduce(or_, (value ^ values[0] for value in set(values)))
        found.append(
            ChangedWord(
                direction,
                label(frames.table, word),
                byte_offset(frames.table, word),
                bits,
                min(values),
                max(values),
                len(set(values)),
                len(at),
                sum(moving[step] == own for step in at) / len(at),
                word in restless,
                _course(values, 1 << frames.table.payload_bits),
                frames.times_s[at[0]],
                frames.times_s[at[-1]],
                names_at(frames.table, word, bits),
            )
        )
    return sorted(found, key=lambda one: (one.restless, -one.alone, UNKNOWN not in one.fields, one.byte_offset))


def _steps(values: Sequence[int]) -> list[int]:
    """Return the numbers of the frames that differ from the previous one."""
    return [index for index in range(1, len(values)) if values[index] != values[index - 1]]


def _course(values: Sequence[int], size: int) -> str:
    steps = [(after - before) % size for before, after in pairwise(values) if after != before]
    if all(step < size // 2 for step in steps):
        return "rises"
    return "falls" if all(step > size // 2 for step in steps) else "both ways"


class SendDifference(NamedTuple):
    """A word in which the SEND frames of two captures differ."""

    word: str
    byte_offset: int
    bits: int
    frames: int
    """Pairs of frames that differ here."""
    first_frame: int
    """The first such pair, from 1, and the word's values there."""
    first_value: int
    second_value: int
    fields: tuple[str, ...]


class SendComparison(NamedTuple):
    """Result of comparing the SEND frames of two captures one by one."""

    first_frames: int
    second_frames: int
    differing_frames: int
    words: tuple[SendDifference, ...]

    @property
    def same(self) -> bool:
        """Whether both captures send the same, to the last frame."""
        return not self.differing_frames and self.first_frames == self.second_frames


def compare_sends(first: Capture, second: Capture, ignored: Sequence[str] = ()) -> SendComparison:
    """Compare the SEND frames of two captures except the fields `ignored`. Raises ConfigError for unknown ones."""
    protocol = protocol_of(first.board)
    masks = masks_of(protocol.send, protocol.fields(ignored))
    one, other = (
        [r.data for r in c.records if _role(protocol, r.kind, r.data) is MessageRole.SEND] for c in (first, second)
    )
    found: dict[int, SendDifference] = {}
    differing = 0
    for number, (a, b) in enumerate(zip(one, other, strict=False), 1):
        words = differing_words(protocol.send, a, b, masks)
        differing += bool(words)
        for word, bits, then, now in words:
            known = found.get(word)
            found[word] = (
                SendDifference(
                    label(protocol.send, word), byte_offset(protocol.send, word), bits, 1, number, then, now, ()
                )
                if known is None
                else known._replace(bits=known.bits | bits, frames=known.frames + 1)
            )
    named = tuple(
        found[word]._replace(fields=names_at(protocol.send, word, found[word].bits)) for word in sorted(found)
    )
    return SendComparison(len(one), len(other), differing, named)
