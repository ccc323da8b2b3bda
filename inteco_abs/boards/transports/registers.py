"""Access to a board's registers: 32 bits at byte offsets 0..252, multiples of 4."""

from __future__ import annotations

import random
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final

from firmware_protocol import ProtocolError
from firmware_protocol.register_messages import NUMBERS, RegisterAccess, answer_bytes, decode_answer, encode_request
from firmware_protocol.registers import Write
from inteco_abs.boards.transports.links import Link
from inteco_abs.errors import LinkError

_MOST_OLD: Final = 100
"""A pause leaves fewer answers to older requests than this."""


class Registers(ABC):
    """The registers of one board, with exclusive access: pairs of index and data accesses stay together.

    All calls raise LinkError when the board cannot be reached, with what to check.
    """

    @abstractmethod
    def read(self, offset: int) -> int:
        """Read the 32 bits at `offset`."""

    @abstractmethod
    def write(self, offset: int, value: int) -> None:
        """Write the 32 bits `value` at `offset`."""

    def run(self, steps: Sequence[RegisterAccess]) -> Sequence[int]:
        """Make these accesses in order, none after a failure; return what was read. Some transports join them."""
        values = []
        for step in steps:
            if isinstance(step, int):
                values.append(self.read(step))
            else:
                self.write(*step)
        return values

    @abstractmethod
    def close(self) -> None:
        """Close the board without writing; may be called twice."""


class LinkedRegisters(Registers):
    """Registers of a mock board at the far end of a link.

    All accesses of one `run` travel in one message: each wait for an answer would cost two process switches.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._number = random.randrange(NUMBERS)  # unlike the numbers of an earlier process

    def read(self, offset: int) -> int:
        """Read the 32 bits at `offset`."""
        return self.run((offset,))[0]

    def write(self, offset: int, value: int) -> None:
        """Write the 32 bits `value` at `offset`; there is no answer."""
        self.run((Write(offset, value),))

    def run(self, steps: Sequence[RegisterAccess]) -> Sequence[int]:
        """Send these accesses, and receive what was read."""
        self._number = (self._number + 1) % NUMBERS
        self._link.write(encode_request(self._number, steps))
        reads = sum(isinstance(step, int) for step in steps)
        return self._newest(reads) if reads else ()

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    def _newest(self, reads: int) -> Sequence[int]:
        """Return the answer to the newest request; drop older ones."""
        for _ in range(_MOST_OLD):
            answer = self._link.read(answer_bytes(reads))
            try:
                number, values = decode_answer(answer)
            except ProtocolError as error:
                raise LinkError(f"the board's answer is malformed: {error}") from error
            if number != self._number:
                continue
            if len(values) != reads:
                raise LinkError(f"the board's answer has {len(values)} values, must be {reads}")
            return values
        raise LinkError("the board answers only old requests: is another program reading from it?")
