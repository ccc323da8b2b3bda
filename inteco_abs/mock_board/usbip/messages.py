"""Decodes and encodes the messages of USB/IP 1.1.1, which are big-endian.

Source: the kernel's `Documentation/usb/usbip_protocol.rst`.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from inteco_abs.mock_board.usbip.usb_device import SetupPacket

_VERSION: Final = 0x0111
_REQUEST_DEVICES, _REPLY_DEVICES = 0x8005, 0x0005
_REQUEST_IMPORT, _REPLY_IMPORT = 0x8003, 0x0003
_SUBMIT, _UNLINK, _RET_SUBMIT, _RET_UNLINK = 1, 2, 3, 4
_DIRECTION_IN: Final = 1
_SHORT_NOT_OK, _ZERO_PACKET = 0x01, 0x40
_NOT_ISOCHRONOUS: Final = 0xFFFFFFFF
_REJECTED: Final = 1
_MOST_BYTES: Final = 16 << 20
"""A longer transfer counts as a damaged length; also the kernel's limit of data in flight for one program."""

_HEADER: Final = struct.Struct(">HHI")
_BUS_ID_BYTES: Final = 32
_RECORD: Final = struct.Struct(f">256s{_BUS_ID_BYTES}sIIIHHH6B")
_COMMAND: Final = struct.Struct(">IIIII28s")
_SUBMIT_BODY: Final = struct.Struct(">IiiII8s")
_RETURN: Final = struct.Struct(">IIIIIiiiII8x")
_UNLINK_RETURN: Final = struct.Struct(">IIIIIi24x")


class MalformedError(Exception):
    """Bytes that are not a message; the rest of the stream cannot be decoded either."""


class DevicesRequest(NamedTuple):
    """OP_REQ_DEVLIST: lists the devices that can be imported."""


class ImportRequest(NamedTuple):
    """OP_REQ_IMPORT."""

    bus_id: bytes


class Submit(NamedTuple):
    """CMD_SUBMIT. `length` is the room for IN data, or the number of bytes in `data`."""

    sequence: int
    device_id: int
    reads: bool
    endpoint: int
    """Endpoint number, without direction."""
    length: int
    setup: SetupPacket
    short_not_ok: bool
    zero_packet: bool
    data: bytes


class Unlink(NamedTuple):
    """CMD_UNLINK: cancels the transfer `victim`."""

    sequence: int
    device_id: int
    victim: int


class DeviceRecord(NamedTuple):
    """A server's description of a device without its interfaces; `speed` is 2 for full, 3 for high."""

    path: bytes
    bus_id: bytes
    bus: int
    device: int
    speed: int
    vendor_id: int
    product_id: int
    release: int
    device_class: int
    device_subclass: int
    device_protocol: int
    configuration: int
    configurations: int
    interfaces: int


def take_request(stream: bytearray) -> DevicesRequest | ImportRequest | None:
    """Remove and return a client's next message from `stream`; None if incomplete. Raises MalformedError."""
    if len(stream) < _HEADER.size:
        return None
    version, code, _ = _HEADER.unpack_from(stream)
    if version != _VERSION or code not in {_REQUEST_DEVICES, _REQUEST_IMPORT}:
        raise MalformedError
    if code == _REQUEST_DEVICES:
        del stream[: _HEADER.size]
        return DevicesRequest()
    whole = _HEADER.size + _BUS_ID_BYTES
    if len(stream) < whole:
        return None
    bus_id = bytes(stream[_HEADER.size : whole]).rstrip(b"\0")
    del stream[:whole]
    return ImportRequest(bus_id)


def take_command(stream: bytearray) -> Submit | Unlink | None:
    """Remove and return an importer's next message from `stream`; None if incomplete. Raises MalformedError."""
    if len(stream) < _COMMAND.size:
        return None
    command, sequence, device_id, direction, endpoint, body = _COMMAND.unpack_from(stream)
    if command == _UNLINK:
        del stream[: _COMMAND.size]
        return Unlink(sequence, device_id, int.from_bytes(body[:4], "big"))
    flags, length, _, packets, _, setup = _SUBMIT_BODY.unpack(body)
    if (
        command != _SUBMIT
        or direction > _DIRECTION_IN
        or endpoint > 0x0F
        or not 0 <= length <= _MOST_BYTES
        or packets not in {0, _NOT_ISOCHRONOUS}
    ):
        raise MalformedError
    reads = direction == _DIRECTION_IN
    whole = _COMMAND.size + (0 if reads else length)
    if len(stream) < whole:
        return None
    data = bytes(stream[_COMMAND.size : whole])
    del stream[:whole]
    short_not_ok, zero_packet = bool(flags & _SHORT_NOT_OK), bool(flags & _ZERO_PACKET)
    return Submit(
        sequence, device_id, reads, endpoint, length, SetupPacket.unpack(setup), short_not_ok, zero_packet, data
    )


def devices_reply(devices: list[tuple[DeviceRecord, list[tuple[int, int, int]]]]) -> bytes:
    """Return OP_REP_DEVLIST: each device with class, subclass and protocol of its interfaces."""
    reply = _HEADER.pack(_VERSION, _REPLY_DEVICES, 0) + len(devices).to_bytes(4, "big")
    for record, interfaces in devices:
        reply += _RECORD.pack(*record) + b"".join(bytes((*interface, 0)) for interface in interfaces)
    return reply


def import_reply(record: DeviceRecord | None) -> bytes:
    """Return OP_REP_IMPORT; None rejects the import."""
    if record is None:
        return _HEADER.pack(_VERSION, _REPLY_IMPORT, _REJECTED)
    return _HEADER.pack(_VERSION, _REPLY_IMPORT, 0) + _RECORD.pack(*record)


def submit_return(sequence: int, status: int, actual: int, data: bytes | bytearray = b"") -> bytes:
    """Return RET_SUBMIT; `actual` is the number of bytes in either direction, `data` the IN data."""
    return _RETURN.pack(_RET_SUBMIT, sequence, 0, 0, 0, status, actual, 0, _NOT_ISOCHRONOUS, 0) + data


def unlink_return(sequence: int, status: int) -> bytes:
    """Return RET_UNLINK."""
    return _UNLINK_RETURN.pack(_RET_UNLINK, sequence, 0, 0, 0, status)
