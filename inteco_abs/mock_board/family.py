"""The mock board's part of a board family."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.boards import BoardProtocol, family_of
from inteco_abs.config import BoardConfig
from inteco_abs.entry_points import attribute

if TYPE_CHECKING:
    from inteco_abs.mock_board.device import Device
    from inteco_abs.mock_board.frontend import FrontEnd, Stream

Connected = Callable[[Mapping[str, int], int], bool]
"""Whether a PWM channel is connected to its pin, from the settings and the channel number."""


_LONGEST_REQUEST: Final = 4
"""Bytes; a longer message is a command."""


def always_connected(_settings: Mapping[str, int], _channel: int) -> bool:
    """Return True, for boards whose drivers write neither pin mode nor direction."""
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class MockFamily:
    """The mock board of one family; `BoardFamily.mock` names it."""

    front_end: Callable[[Device], FrontEnd]
    """Makes the front end of a device. Raises ConfigError for a rig on missing channels."""
    reported: Callable[[Device, BoardProtocol | None, bytes], FrontEnd]
    """Makes the front end of a reported board, from an image in its protocol. Raises ValueError for an invalid one."""
    connected: Callable[[BoardConfig], Connected] = lambda _wiring: always_connected
    is_command: Callable[[bytes | bytearray], bool] = lambda message: len(message) > _LONGEST_REQUEST
    """Whether a message of the host changes something, rather than asks."""
    identity_offset: int | None = None
    """Byte of an answer that identifies the board; None if there is none."""
    has_alarms: bool = False
    """Whether the board has alarm flags."""
    usb_device: Callable[[FrontEnd, Any, int], Any] | None = None
    """Makes its USB device from the front end, a function that replaces the usual `UsbIdentity`, and a serial number;
    None for a board without USB. Raises ValueError if the serial number is not a mock's."""
    stream: Callable[[FrontEnd], Stream] | None = None
    """Makes the front end's byte stream for a serial port; None for a board without one."""


def mock_family(kind: str) -> MockFamily:
    """Return the mock of the family that `board.kind` names; raises ConfigError if there is no such family."""
    found: MockFamily = attribute(family_of(kind).mock)
    return found


def front_end_of(device: Device) -> FrontEnd:
    """Return the front end of `device` in its family's protocol."""
    return mock_family(device.kind).front_end(device)
