"""Interfaces of a mock board's side of the wire."""

from __future__ import annotations

from typing import Protocol

from firmware_protocol import FrameTable
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.mock_board.device import Cable, Device


class FrontEnd(Protocol):
    """A device that speaks its family's protocol.

    Drops malformed messages, as no reply of a real board to them is known; `rejected` counts them.
    """

    device: Device
    rejected: int

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Receive a message from the host."""
        ...

    def bulk_in(self, length: int) -> bytes:
        """Return at most `length` bytes of the oldest waiting answer; empty if there is none."""
        ...


class Stream(Protocol):
    """A front end behind a FIFO: a byte stream without boundaries."""

    front_end: FrontEnd

    def feed(self, data: bytes | bytearray) -> bytes:
        """Receive bytes from the host, or none; return what the board sends."""
        ...


def require_terminals(cable: Cable, read: FrameTable) -> None:
    """Raise ConfigError for a rig on a channel that the logic does not have."""
    wanted = {
        "drive_pwm": f"pwm{cable.drive_pwm}_width",
        "brake_pwm": f"pwm{cable.brake_pwm}_width",
        "road_encoder": f"encoder{cable.road_encoder}_count",
        "wheel_encoder": f"encoder{cable.wheel_encoder}_count",
    }
    mistakes = [
        ConfigIssue(f"simulation.{key}", f"{getattr(cable, key)}: {read.title} has no such channel")
        for key, name in wanted.items()
        if name not in read.fields
    ]
    if mistakes:
        raise ConfigError(mistakes)
