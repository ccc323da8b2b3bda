"""Who carries the bytes between host and board."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Final, Protocol

from inteco_abs.errors import ConfigError, LinkError, Mistake

_MOST_WAITING: Final = 4
"""More late answers than this is another program reading along; the next exchange will say so."""


class Link(ABC):
    """A pair of pipes to one board. Messages keep their boundaries, as USB bulk transfers do.

    Both calls raise LinkError when the board cannot be reached, with a text that says what to check.
    """

    @abstractmethod
    def write(self, data: bytes | bytearray) -> None:
        """Send one message to the board; `data` may change once the call has returned."""

    @abstractmethod
    def read(self, length: int) -> bytes:
        """Receive one message of at most `length` bytes."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the board. Writes nothing; may be called twice."""

    def discard(self, length: int) -> None:
        """Drop messages of at most `length` bytes that the board has sent and nobody waits for any more."""
        with suppress(LinkError):
            for _ in range(_MOST_WAITING):
                self.read(length)


class BulkDevice(Protocol):
    """The board's side of a pair of bulk endpoints."""

    def bulk_out(self, data: bytes | bytearray) -> None:
        """What the host writes."""
        ...

    def bulk_in(self, length: int) -> bytes:
        """What the host gets; empty stands for a time-out."""
        ...


class InProcessLink(Link):
    """A device model in this process, by direct calls."""

    def __init__(self, device: BulkDevice) -> None:
        self._device: BulkDevice | None = device

    def write(self, data: bytes | bytearray) -> None:
        """Hand one message to the device."""
        self._reach().bulk_out(data)

    def read(self, length: int) -> bytes:
        """Next answer of the device."""
        data = self._reach().bulk_in(length)
        if not data:
            raise LinkError("the board did not answer: is another program reading from it?")
        return data

    def close(self) -> None:
        """Let go of the device."""
        self._device = None

    def _reach(self) -> BulkDevice:
        if self._device is None:
            raise LinkError("the link to the board is closed")
        return self._device


SCHEMES: Final = {"sim": "the mock RT-DAC/USB2 board with the simulated rig inside"}
"""Board addresses that this version opens, by what stands before the colon."""


def check_address(uri: str) -> None:
    """Raise ConfigError unless `uri`, such as `sim:`, is a board address."""
    scheme, colon, rest = uri.partition(":")
    if not colon or scheme not in SCHEMES:
        known = "; ".join(f"{name}: is {what}" for name, what in SCHEMES.items())
        raise ConfigError([Mistake("--board", f"{uri!r} is no board address of this version; {known}")])
    if rest:
        raise ConfigError([Mistake("--board", f"{uri!r}: nothing may follow {scheme}:")])
