"""A USB device at packet level: what one token of the host gets, from the standard requests to the bulk endpoints.

Packets and not bytes are the seam, because only then do short packets, zero-length packets, NAK, STALL and babble
come out as on the wire. One configuration, one interface, one alternate setting, as `usb_descriptors` has them.
Source: USB 2.0, chapters 8 and 9.
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
    """How a device answers a token or packet when it has no data to send."""

    ACK = "taken"
    NAK = "not now: ask again after the next kick"
    STALL = "refused"


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
        """The fields of eight bytes; raises ValueError for any other number of bytes."""
        if len(data) != _SETUP.size:
            raise ValueError(f"a setup packet has {_SETUP.size} bytes, not {len(data)}")
        return cls(*_SETUP.unpack(data))

    def pack(self) -> bytes:
        """The eight bytes."""
        return _SETUP.pack(self.request_type, self.request, self.value, self.index, self.length)

    @property
    def reads(self) -> bool:
        """Whether the device sends the data."""
        return bool(self.request_type & _IN)


class UsbDevice(ABC):
    """A device that is plugged in. Not thread-safe: its host calls it under a lock.

    `kick` is called when a host that got a NAK should ask again. Halts and waiting packets do not survive a bus
    reset; what the firmware makes of messages does.
    """

    largest_message_bytes: ClassVar[int] = 4096
    """A longer message is cut here, so that a host that never ends one cannot fill the memory."""

    def __init__(self, identity: UsbIdentity) -> None:
        self.identity = identity
        self.kick: Callable[[], None] = lambda: None
        self.configuration = 0
        self._halted: set[int] = set()
        self._arriving = bytearray()
        self._departing: dict[int, deque[bytes]] = {}

    @property
    def endpoints(self) -> tuple[int, ...]:
        """Addresses of the bulk endpoints that exist now: none before a configuration is set."""
        return self.identity.endpoints if self.configuration else ()

    def reset(self) -> None:
        """Bus reset: as after plugging in, but for what the firmware keeps."""
        self.configuration = 0
        self._halted.clear()
        self._arriving.clear()
        self._departing.clear()

    def control(self, setup: SetupPacket, data: bytes = b"") -> UsbAnswer:
        """One control transfer; `data` is what the host sends. Data, ACK for done without data, NAK or STALL."""
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
        """The host asks bulk endpoint `endpoint` for one packet."""
        if endpoint in self._halted:
            return Handshake.STALL
        waiting = self._departing.get(endpoint)
        return waiting.popleft() if waiting else Handshake.NAK

    def packet_out(self, endpoint: int, packet: bytes) -> Handshake:
        """The host sends one packet to bulk endpoint `endpoint`."""
        if endpoint in self._halted:
            return Handshake.STALL
        self._arrive(packet)
        return Handshake.ACK

    @property
    def due_s(self) -> float:
        """Time after which a host that got a NAK should ask again, whatever happens; endless if there is none."""
        return math.inf

    def _arrive(self, packet: bytes) -> None:
        """Put packets together: one that is not full ends a message."""
        room = self.largest_message_bytes - len(self._arriving)
        self._arriving += packet[:room]
        if len(packet) < self.identity.speed.packet_bytes:
            message = bytes(self._arriving)
            self._arriving.clear()
            self._take(message)

    @abstractmethod
    def catch_up(self) -> None:
        """Use idle time."""

    @abstractmethod
    def _take(self, message: bytes) -> None:
        """The firmware gets a whole message of the bulk OUT endpoint."""

    @abstractmethod
    def _vendor(self, setup: SetupPacket, data: bytes) -> UsbAnswer:
        """The firmware gets a vendor request."""

    def _send(self, endpoint: int, message: bytes) -> None:
        """Let `message` wait for the host, in packets of which the last is not full and may be empty."""
        size = self.identity.speed.packet_bytes
        self._offer(endpoint, [message[at : at + size] for at in range(0, len(message) + 1, size)])

    def _offer(self, endpoint: int, packets: list[bytes]) -> None:
        self._departing.setdefault(endpoint, deque()).extend(packets)
        self.kick()

    def _waiting(self, endpoint: int) -> int:
        """Packets that the host has not fetched yet."""
        return len(self._departing.get(endpoint, ()))

    def _halt(self, endpoint: int) -> None:
        self._halted.add(endpoint)

    def _standard(self, setup: SetupPacket) -> UsbAnswer:
        recipient = setup.request_type & ~_IN
        if recipient == _TO_DEVICE:
            return self._asked(setup) if setup.reads else self._told(setup)
        if recipient == _TO_INTERFACE and setup.index == 0 and self.configuration:
            return self._interface(setup)
        if recipient == _TO_ENDPOINT and (setup.index in self.endpoints or not setup.index & ~ENDPOINT_DIRECTION_IN):
            return self._endpoint(setup)
        return Handshake.STALL

    def _asked(self, setup: SetupPacket) -> UsbAnswer:
        if setup.request == _GET_DESCRIPTOR:
            found = self.identity.descriptor(setup.value >> 8, setup.value & 0xFF)
            return Handshake.STALL if found is None else found
        if setup.request == _GET_CONFIGURATION:
            return bytes((self.configuration,))
        return _NO_STATUS if setup.request == _GET_STATUS else Handshake.STALL

    def _told(self, setup: SetupPacket) -> Handshake:
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
            self._halt(setup.index)
        else:
            self._halted.discard(setup.index)
        self.kick()
        return Handshake.ACK

    def _configure(self, value: int) -> Handshake:
        if value not in (0, CONFIGURATION):
            return Handshake.STALL
        self.configuration = value
        self._release_halts()
        return Handshake.ACK

    def _release_halts(self) -> None:
        self._halted.clear()
        self.kick()
