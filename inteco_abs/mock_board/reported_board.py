"""A mock of one reported board: its descriptors, header and first image, with the simulated rig."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from firmware_protocol import FrameTable
from inteco_abs.boards import BoardProtocol
from inteco_abs.mock_board.device import Device
from inteco_abs.mock_board.frontend import FrontEnd
from inteco_abs.mock_board.usbip.usb_descriptors import UsbIdentity, UsbSpeed

_DEVICE, _CONFIGURATION, _STRING, _INTERFACE, _ENDPOINT = 1, 2, 3, 4, 5
_BULK: Final = 2
_DEVICE_BYTES: Final = 18
_HIGH_SPEED: Final = "480"
_MANUFACTURER_AT: Final = 14
"""Byte of the device descriptor with the index of the manufacturer's string; product and serial number follow."""


@dataclass(frozen=True, slots=True)
class ReportedIdentity(UsbIdentity):
    """The reported descriptors, with a mock's serial number."""

    raw: bytes = b""
    """Device descriptor, then all descriptors of the first configuration."""

    @classmethod
    def of(cls, like: UsbIdentity, raw: bytes, strings: Mapping[str, str]) -> ReportedIdentity:
        """Return the reported descriptors, completed from `like`. Raises ValueError for malformed ones.

        `strings` may have `manufacturer`, `product`, and `speed` in Mbit/s.
        """
        parts = _parts(raw, _DEVICE_BYTES)
        endpoints = tuple(part[2] for part in parts if part[1] == _ENDPOINT and part[3] & 3 == _BULK)
        if len(raw) < _DEVICE_BYTES or raw[:2] != bytes((_DEVICE_BYTES, _DEVICE)) or not endpoints:
            raise ValueError("no device descriptor with a configuration of bulk endpoints")
        vendor_id, product_id, release = struct.unpack_from("<HHH", raw, 8)
        return cls(
            like.serial,
            vendor_id,
            product_id,
            UsbSpeed.HIGH if strings.get("speed", _HIGH_SPEED) == _HIGH_SPEED else UsbSpeed.FULL,
            strings.get("manufacturer", ""),
            strings.get("product", ""),
            release,
            (raw[4], raw[5], raw[6]),
            next(((part[5], part[6], part[7]) for part in parts if part[1] == _INTERFACE), like.interface_class),
            endpoints,
            raw,
        )

    def descriptor(self, kind: int, index: int) -> bytes | None:
        """Return the whole descriptor `index` of type `kind`; None if there is none."""
        raw = self.raw
        if (kind, index) == (_DEVICE, 0):
            return raw[:_DEVICE_BYTES]
        if (kind, index) == (_CONFIGURATION, 0):
            return raw[_DEVICE_BYTES : _DEVICE_BYTES + struct.unpack_from("<H", raw, _DEVICE_BYTES + 2)[0]]
        if kind == _STRING and index:
            at = raw.find(index, _MANUFACTURER_AT, _MANUFACTURER_AT + len(self.strings))
            return UsbIdentity.descriptor(self, kind, at - _MANUFACTURER_AT + 1) if at >= 0 else None
        return UsbIdentity.descriptor(self, kind, index)


def _parts(raw: bytes, at: int) -> list[bytes]:
    """Split the descriptors; raises ValueError where one has no length or goes beyond the end."""
    parts = []
    while at < len(raw):
        length = raw[at]
        if length < 2 or at + length > len(raw):
            raise ValueError(f"a descriptor of {length} bytes at byte {at} of {len(raw)}")
        parts.append(raw[at : at + length].ljust(8, b"\0"))
        at += length
    return parts


class ReportedFrontEnd:
    """A front end that answers with the image of a reported board, until something changes it.

    Fields that only the board writes, such as its header, stay as reported; the others echo the host's writes; two
    counters, the timers and changes of pins come from the simulated rig. `image` is a READ frame of any logic with the
    size of the tables; `front_end` makes the device's front end from it. Raises ValueError for an image of another
    size, or a damaged one.
    """

    def __init__(
        self,
        front_end: Callable[[Device, bytes], FrontEnd],
        device: Device,
        read: FrameTable,
        send: FrameTable,
        image: bytes,
    ) -> None:
        if len(image) != read.size:
            raise ValueError(f"an image of {len(image)} bytes: a {read.title} frame has {read.size}")
        shown = int.from_bytes(image, "little")
        fixed = _bits(read, read.fixed)  # the tables reject the header of another logic
        ours = int.from_bytes(read.encode({}), "little") & fixed
        readable = (shown & ~fixed | ours).to_bytes(read.size, "little")
        self.device, self.rejected, self._size = device, 0, read.size
        self._front_end = front_end(device, readable)
        cable = device.cable
        counts = f"encoder{cable.road_encoder}_count", f"encoder{cable.wheel_encoder}_count"
        values = read.decode_some(readable, counts)
        device.begin_counts(*(int(values[name]) for name in counts))
        only_read = [
            name for name in read.fields if name not in send.fields and name not in counts and not _moves(name)
        ]
        self._constant = _bits(read, only_read)
        self._reported = shown & self._constant
        pins = [name for name in ("pin_input",) if name in read.fields]
        levels = int.from_bytes(read.encode(dict.fromkeys(pins, device.pins())), "little")
        self._flipped = (shown ^ levels) & _bits(read, pins)

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Receive a message from the host."""
        self._front_end.bulk_out(data)
        self.rejected = self._front_end.rejected

    def bulk_in(self, length: int) -> bytes:
        """Return the next answer."""
        answer = self._front_end.bulk_in(self._size)
        if len(answer) != self._size:
            return answer[:length]
        shown = (int.from_bytes(answer, "little") ^ self._flipped) & ~self._constant | self._reported
        return shown.to_bytes(self._size, "little")[:length]


def reported_frames(
    front_end: Callable[[Device, bytes], FrontEnd],
) -> Callable[[Device, BoardProtocol | None, bytes], FrontEnd]:
    """Return `MockFamily.reported` for a family with frames; `front_end` makes the family's own front end."""

    def reported(device: Device, protocol: BoardProtocol | None, image: bytes) -> FrontEnd:
        if protocol is None:
            raise ValueError("its board has no protocol")
        return ReportedFrontEnd(front_end, device, protocol.read, protocol.send, image)

    return reported


def _moves(name: str) -> bool:
    return name == "pin_input" or (name.startswith("timer") and name.endswith("_value"))


def _bits(table: FrameTable, names: Iterable[str]) -> int:
    """Return the bits of the named fields in a frame as one little-endian number."""
    mask = 0
    for name in names:
        for part in table.fields[name][1]:
            mask |= part.mask << (part.word + table.data_from) * table.word_bits + part.low
    return mask
