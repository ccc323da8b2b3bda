"""What every face of the mock board has, whatever the wire."""

from __future__ import annotations

from typing import Protocol

from inteco_abs.mock_board.device import Device


class Face(Protocol):
    """The device as a host sees it: messages in, messages out."""

    device: Device
    rejected: int
    """Messages, or parts of them, that were dropped."""

    def bulk_out(self, data: bytes | bytearray) -> None:
        """What the host writes."""
        ...

    def bulk_in(self, length: int) -> bytes:
        """What the host gets; empty if nothing waits for it."""
        ...
