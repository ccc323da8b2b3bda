"""Digital outputs that change with every frame and are echoed: a frame number and a watchdog pulse."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from firmware_protocol import FrameTable

_FIELD: Final = "pin_output"


class EchoedPins:
    """The output latch of CN1: the pins `numbering` carry the frame's number, the pin `watchdog` changes with a beat.

    `latch` are the levels of the other pins; the board must also echo those in the mask `constant`. `watchdog` -1:
    none. A number of n pins repeats after 2^n frames, so it cannot detect an answer late by a multiple of that.
    """

    def __init__(
        self,
        send: FrameTable,
        read: FrameTable,
        latch: int,
        numbering: Sequence[int],
        watchdog: int = -1,
        constant: int = 0,
    ) -> None:
        self._sent_at, self._echoed_at = _bytes_of(send), _bytes_of(read)
        self._numbers = 1 << len(numbering)
        self._number = 0
        self._level = 0
        own = [*numbering, watchdog] if watchdog >= 0 else [*numbering]
        latches = [_with(latch, own, state) for state in range(1 << len(own))]
        self._sent = [send.encode({_FIELD: one})[self._sent_at] for one in latches]
        mask = _with(constant, own, -1)
        self._mask = int.from_bytes(read.encode({_FIELD: mask})[self._echoed_at], "little")
        self._echoes = [int.from_bytes(read.encode({_FIELD: one & mask})[self._echoed_at], "little") for one in latches]

    def put_into(self, image: bytearray, *, beat: bool) -> None:
        """Write the next frame's number into `image`; a `beat` toggles the watchdog's pin."""
        self._number = (self._number + 1) % self._numbers
        if beat:
            self._level ^= self._numbers
        image[self._sent_at] = self._sent[self._number | self._level]

    def echoed(self, frame: bytes) -> bool:
        """Return whether an answer echoes the pins of the newest frame."""
        echo = int.from_bytes(frame[self._echoed_at], "little") & self._mask
        return echo == self._echoes[self._number | self._level]


def _with(latch: int, pins: Sequence[int], state: int) -> int:
    """Return `latch` with bit i of `state` at the i-th pin."""
    for i, pin in enumerate(pins):
        latch = latch & ~(1 << pin) | (state >> i & 1) << pin
    return latch


def _bytes_of(table: FrameTable) -> slice:
    _, layout = table.fields[_FIELD]
    size = table.word_bits // 8
    first, last = layout[0].word + table.data_from, layout[-1].word + table.data_from
    return slice(first * size, (last + 1) * size)
