"""A USB device at packet level: its answers to standard requests and to tokens for its bulk endpoints.

The interface is packets, not bytes, so that short packets, zero-length packets, NAK, STALL and babble occur as on the
wire. One configuration, one interface, one alternate setting, as in `usb_descriptors`. Source: USB 2.0, chapters 8
and 9.
"""

from __future__ import annotations

import math
import struct
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import ClassVar, Final

from inteco_abs.mock_board.usbip.usb_descriptors import CONFIGURATION, ENDPOINT_DIRECTION_IN, UsbIdentity

_SETUP: Final = struct.Struct("<BBHHH")
_OUT, _IN = 0x00, 0x80
_TO_DEVICE, _TO_INTERFACE, _TO_ENDPOINT = 0, 1, 2
_KIND_MASK: Final = 0x60
_STANDARD, _VENDOR = 0x00, 0x40
_GET_STATUS, _CLEAR_FEATURE, _SET_FEATURE, _SET_ADDRESS, _GET_DESCRIPTOR = 0, 1, 3, 5, 6
_GET_CONFIGURATION, _SET_CONFIGURATION, _GET_INTERFACE, _SET_INTERFACE = 8, 9, 10, 11
_ENDPOINT_HALT: Final = 0
_NO_STATUS: Final = b"\0\0"


class Handshake(Enum):
    """Answer of a device without data."""

    ACK = "accepted"
    NAK = "not ready: ask again after `on_ready`"
    STALL = "rejected"


UsbAnswer = bytes | Handshake
"""Data to the host, or a handshake."""


@dataclass(frozen=True, slots=True)
class SetupPacket:
    """The eight bytes that begin a control transfer."""

    request_type: int
    request: int
    value: int
    index: int
    length: int

    @classmethod
    def unpack(cls, data: bytes) -> SetupPacket:
        """Return the packet of eight bytes; raises ValueError for another length."""
        if len(data) != _SETUP.size:
            raise ValueError(f"a setup packet has {_SETUP.size} bytes, not {len(data)}")
        return cls(*_SETUP.unpack(data))

    def pack(self) -> bytes:
        """Return the eight bytes."""
        return _SETUP.pack(self.request_type, self.request, self.value, self.index, self.length)

    @property
    def reads(self) -> bool:
        """Whether the device sends the data."""
        return bool(self.request_type & _IN)


class UsbDevice(ABC):
    """A device that is plugged in. Not thread-safe: its host calls it under a lock.

    `on_ready` is called when a host that got a NAK should ask again. A bus reset clears halts and waiting packets, but
    not the firmware's state.
    """

    largest_message_bytes: ClassVar[int] = 4096
    """Limit of a message, so that a host that never ends one cannot fill the memory."""

    def __init__(self, identity: UsbIdentity) -> None:
        self.identity = identity
        self.on_ready: Callable[[], None] = lambda: None
        self.configuration = 0
        self._halted: set[int] = set()
        self._arriving = bytearray()
        self._departing: dict[int, deque[bytes]] = {}

    @property
    def endpoints(self) -> tuple[int, ...]:
        """Addresses of the bulk endpoints; none before a configuration is set."""
        return self.identity.endpoints if self.configuration else ()

    def reset(self) -> None:
        """Reset the bus: clear everything but the firmware's state."""
        self.configuration = 0
        self._halted.clear()
        self._arriving.clear()
        self._departing.clear()

    def control(self, setup: SetupPacket, data: bytes = b"") -> UsbAnswer:
        """Execute a control transfer with the host's `data`; return data, ACK for success, NAK or STALL."""
        kind = setup.request_type & _KIND_MASK
        if kind == _STANDARD:
            answer = self._standard(setup)
        elif kind == _VENDOR:
            answer = self._vendor(setup, data)
        else:
            answer = Handshake.STALL
        if isinstance(answer, bytes):
            return answer[: setup.length] if setup.reads else Handshake.STALL
        return answer

    def packet_in(self, endpoint: int) -> UsbAnswer:
        """Return the next packet of a bulk IN endpoint, NAK or STALL."""
        if endpoint in self._halted:
            return Handshake.STALL
        waiting = self._departing.get(endpoint)
        return waiting.popleft() if waiting else Handshake.NAK

    def packet_out(self, endpoint: int, packet: bytes) -> Handshake:
        """Receive a packet at a bulk OUT endpoint."""
        if endpoint in self._halted:
            return Handshake.STALL
        self._arrive(packet)
        return Handshake.ACK

    @property
    def due_s(self) -> float:
        """Time after which a host that got a NAK should ask again, s; infinite if only `on_ready` counts."""
        return math.inf

    def _arrive(self, packet: bytes) -> None:
        """Join packets; a short one ends the message."""
        room = self.largest_message_bytes - len(self._arriving)
        self._arriving += packet[:room]
        if len(packet) < self.identity.speed.packet_bytes:
            message = bytes(self._arriving)
            self._arriving.clear()
            self._receive(message)

    @abstractmethod
    def catch_up(self) -> None:
        """Advance the rig in idle time, so that little is left to compute when the host waits for an answer."""

    @abstractmethod
    def _receive(self, message: bytes) -> None:
        """Handle a whole message of the bulk OUT endpoint."""

    @abstractmethod
    def _vendor(self, setup: SetupPacket, data: bytes) -> UsbAnswer:
        """Handle a vendor request."""

    def _send(self, endpoint: int, message: bytes) -> None:
        """Queue `message` for the host, in packets; the last is short and may be empty."""
        size = self.identity.speed.packet_bytes
        self._queue(endpoint, [message[at : at + size] for at in range(0, len(message) + 1, size)])

    def _queue(self, endpoint: int, packets: list[bytes]) -> None:
        self._departing.setdefault(endpoint, deque()).extend(packets)
        self.on_ready()

    def _waiting(self, endpoint: int) -> int:
        """Return the number of packets that the host has not fetched yet."""
        return len(self._departing.get(endpoint, ()))

    def _standard(self, setup: SetupPacket) -> UsbAnswer:
        recipient = setup.request_type & ~_IN
        if recipient == _TO_DEVICE:
            return self._read_device(setup) if setup.reads else self._write_device(setup)
        if recipient == _TO_INTERFACE and setup.index == 0 and self.configuration:
            return self._interface(setup)
        if recipient == _TO_ENDPOINT and (setup.index in self.endpoints or not setup.index & ~ENDPOINT_DIRECTION_IN):
            return self._endpoint(setup)
        return Handshake.STALL

    def _read_device(self, setup: SetupPacket) -> UsbAnswer:
        if setup.request == _GET_DESCRIPTOR:
            found = self.identity.descriptor(setup.value >> 8, setup.value & 0xFF)
            return Handshake.STALL if found is None else found
        if setup.request == _GET_CONFIGURATION:
            return bytes((self.configuration,))
        return _NO_STATUS if setup.request == _GET_STATUS else Handshake.STALL

    def _write_device(self, setup: SetupPacket) -> Handshake:
        if setup.request == _SET_CONFIGURATION:
            return self._configure(setup.value)
        return Handshake.ACK if setup.request == _SET_ADDRESS else Handshake.STALL

    def _interface(self, setup: SetupPacket) -> UsbAnswer:
        if setup.reads:
            return {_GET_INTERFACE: b"\0", _GET_STATUS: _NO_STATUS}.get(setup.request, Handshake.STALL)
        if setup.request == _SET_INTERFACE and setup.value == 0:
            self._release_halts()
            return Handshake.ACK
        return Handshake.STALL

    def _endpoint(self, setup: SetupPacket) -> UsbAnswer:
        if setup.reads:
            halted = bytes((setup.index in self._halted, 0))
            return halted if setup.request == _GET_STATUS else Handshake.STALL
        if setup.value != _ENDPOINT_HALT or setup.request not in {_SET_FEATURE, _CLEAR_FEATURE}:
            return Handshake.STALL
        if setup.request == _SET_FEATURE:
            self._halted.add(setup.index)
        else:
            self._halted.discard(setup.index)
        self.on_ready()
        return Handshake.ACK

    def _configure(self, value: int) -> Handshake:
        if value not in (0, CONFIGURATION):
            return Handshake.STALL
        self.configuration = value
        self._release_halts()
        return Handshake.ACK

    def _release_halts(self) -> None:
        self._halted.clear()
        self.on_ready()
