"""What every mock board looks like from its wire, whatever its frames."""

from __future__ import annotations

from typing import Protocol

from inteco_abs.mock_board.device import Device


class Face(Protocol):
    """A device in its kind of board's frames: messages in, messages out.

    Malformed messages are dropped, as nothing is known of any complaint of a real board; `rejected` counts them.
    """

    device: Device
    rejected: int

    def bulk_out(self, data: bytes | bytearray) -> None:
        """What the host writes."""
        ...

    def bulk_in(self, length: int) -> bytes:
        """What the host gets: at most `length` bytes of the oldest waiting answer, empty if there is none."""
        ...
