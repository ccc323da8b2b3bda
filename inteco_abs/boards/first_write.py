"""Lists what the first write to a board would change, word by word, for a person to check before."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from enum import StrEnum
from typing import NamedTuple

from firmware_protocol.fields import Buffer, FrameTable, sent_back, unnamed
from inteco_abs.boards.frame_labels import label, mask_of, names_at


class Remark(StrEnum):
    """Remarks on a word."""

    NONE = ""
    UNKNOWN = "no field is known here: sent back as read"
    CUT = "no field is known here: sent back without its top bit, which marks a command"
    RUNS = "a PWM that this wiring does not use is on, and stays on"
    NUMBER = "numbers the frames: another in each"


class PlannedWord(NamedTuple):
    """A word or register of the first write that changes, or whose meaning is unknown."""

    place: str
    """Place as in the protocol reference: `w22` is word 22, `b21` data byte 21, `0x6C` a register."""
    names: tuple[str, ...]
    now: int
    """Value in a frame that changes nothing."""
    planned: int
    remark: Remark = Remark.NONE

    def __str__(self) -> str:
        width = 4 if self.place.startswith("w") else 2
        change = f"0x{self.now:0{width}X} -> 0x{self.planned:0{width}X}"
        return f"{self.place:>5}  {change:18}  {', '.join(self.names)}{f'  ({self.remark})' if self.remark else ''}"


def planned_words(
    read: FrameTable, send: FrameTable, frame: Buffer, image: Buffer, decided: Collection[str], number_word: int
) -> Iterator[PlannedWord]:
    """Yield the remarkable words of the first frame `image` to a board that reads `frame`.

    `decided` are the fields that differ from the reading; `number_word` is the word that numbers frames, or -1.
    """
    now, planned = send.words(sent_back(read, send, frame)), send.words(image)
    unknown = unnamed(read, send, frame)
    running = [name for name in send.fields if name.endswith("_width") and name not in decided]
    for word, (before, after) in enumerate(zip(now, planned, strict=True)):
        data = word - send.data_from
        raw = unknown.get(data, 0) if before == after else 0
        remark = Remark.NONE
        if word == number_word:
            remark = Remark.NUMBER
        elif raw:
            remark = Remark.CUT if raw >> send.payload_bits else Remark.UNKNOWN
        elif before == after and any(before & mask_of(send.fields[name][1], data) for name in running):
            remark = Remark.RUNS
        if before != after or remark:
            names = names_at(send, word, before ^ after or raw or before or 1)
            yield PlannedWord(label(send, word), names, before, after, remark)
