"""What every mock board looks like from its wire, whatever its frames."""

from __future__ import annotations

from typing import Protocol

from firmware_protocol import FrameTable
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.mock_board.device import Cable, Device


class FrontEnd(Protocol):
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


class Stream(Protocol):
    """The same board behind a FIFO: bytes come and go in any cuts."""

    front_end: FrontEnd

    def feed(self, data: bytes | bytearray) -> bytes:
        """Take bytes of the host; what the board answers to them."""
        ...


def require_terminals(cable: Cable, read: FrameTable) -> None:
    """Raise ConfigError for a rig that is plugged into a channel which the logic with these answers does not have."""
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
