"""Imports Wireshark captures: extracts the messages of one board from a USB monitor's capture of all devices.

The captured computer needs no software of this project, so that the vendor's program can be captured with its board.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Final, NamedTuple

from inteco_abs.boards import UsbTraffic, family_speaking, protocol_name
from inteco_abs.config import load_config
from inteco_abs.entry_points import attribute
from inteco_abs.errors import CaptureError, ConfigError, ConfigIssue, near_file
from inteco_abs.version import __version__
from inteco_abs.wire.capture import Capture, Record, RecordKind
from inteco_abs.wire.usbmon import IN, LINK_TYPES, MonitoredUrb, Transfer, decode

_LITTLE_PCAP: Final = (b"\xd4\xc3\xb2\xa1", b"\x4d\x3c\xb2\xa1", b"\x34\xcd\xb2\xa1")
"""First bytes of little-endian pcap files: microseconds, nanoseconds, and one with longer packet headers."""
_PCAPNG: Final = b"\x0a\x0d\x0d\x0a"
_BIG_PCAPNG: Final = b"\x1a\x2b\x3c\x4d"
_ORDER_AT: Final = 8
_NO_LIBRARY: Final = "Wireshark captures need the package dpkt: pip install inteco-abs[capture]"


class Packet(NamedTuple):
    """A decoded packet with its capture time, s."""

    time_s: float
    urb: MonitoredUrb


def import_pcap(path: Path, board: str | None = None, *, device: str = "") -> Capture:
    """Return the messages of one board in a pcap or pcapng file.

    `board` is its protocol, by default that of the default profile; `device` is its BUS.ADDRESS, by default the only
    device with this board's traffic. Raises CaptureError for an unusable file, or if no device or several match,
    ConfigError for a wrong `board` or `device`.
    """
    board = board or protocol_name(load_config().board)
    traffic = family_speaking(board, "--protocol").traffic
    if traffic is None:
        raise ConfigError([ConfigIssue("--protocol", f"{board!r}: its traffic in a USB capture is not known")])
    if device and not _is_device(device):
        raise ConfigError([ConfigIssue("--device", f"{device!r}: must be bus and address, as in 1.5")])
    link_type, packets = _read(path)
    chosen = device or _only_candidate(path, packets, traffic)
    own = [packet for packet in packets if packet.urb.device == chosen]
    if not own:
        raise CaptureError(f"{path}: no packets of device {chosen}; {_seen(packets)}")
    start_s = packets[0].time_s
    records = _Records(start_s, traffic).collect(own)
    if not any(record.kind in {RecordKind.OUT, RecordKind.IN} for record in records):
        raise CaptureError(f"{path}: device {chosen} has no messages on this board's endpoints; {_seen(packets)}")
    source = f"inteco-abs {__version__} from {path.name}, device {chosen}"
    return Capture(board, source, f"of the monitor, {LINK_TYPES[link_type]}", tuple(records), str(path))


def _is_device(text: str) -> bool:
    bus, _, address = text.partition(".")
    return all(part.isascii() and part.isdecimal() for part in (bus, address))


def _read(path: Path) -> tuple[int, list[Packet]]:
    """Return link type and packets of the file; raises CaptureError."""
    if find_spec("dpkt") is None:
        raise CaptureError(_NO_LIBRARY)
    from dpkt import dpkt, pcap, pcapng  # noqa: PLC0415  an extra

    try:
        with path.open("rb") as file:
            start = file.read(_ORDER_AT + len(_BIG_PCAPNG))
            file.seek(0)
            reader = (pcapng if start.startswith(_PCAPNG) else pcap).Reader(file)
            link_type = reader.datalink()
            if link_type not in LINK_TYPES:
                known = "; ".join(f"{number} is {what}" for number, what in LINK_TYPES.items())
                raise CaptureError(f"{path}: link type {link_type} is not a USB monitor's; {known}")
            packets = list(_decoded(path, reader, link_type, big_endian=_big_endian(start)))
    except OSError as error:
        hint = "" if path.exists() else near_file(path) or "; name a capture of Wireshark, or a session"
        raise CaptureError(f"{path}: cannot be read: {error.strerror or error}{hint}") from error
    except (dpkt.Error, ValueError, ArithmeticError, IndexError, struct.error, MemoryError) as error:
        # all that the library raises for a damaged file
        raise CaptureError(
            f"{path}: not a pcap or pcapng file, or damaged or truncated ({error or type(error).__name__})"
        ) from error
    if not packets:
        raise CaptureError(f"{path}: no packets; start the capture before the program that uses the board")
    return link_type, packets


def _big_endian(start: bytes) -> bool:
    if start.startswith(_PCAPNG):
        return start.endswith(_BIG_PCAPNG)
    return not start.startswith(_LITTLE_PCAP)


def _decoded(
    path: Path, reader: Iterable[tuple[float, bytes]], link_type: int, *, big_endian: bool
) -> Iterator[Packet]:
    for number, (time_s, packet) in enumerate(reader, 1):
        try:
            yield Packet(float(time_s), decode(packet, link_type, big_endian=big_endian))
        except CaptureError as error:
            raise CaptureError(f"{path}: packet {number} {error}") from error


def _only_candidate(path: Path, packets: Iterable[Packet], traffic: UsbTraffic) -> str:
    bulk = [urb for _, urb in packets if urb.transfer == Transfer.BULK]
    found = sorted({urb.device for urb in bulk if traffic.sent_by(urb.endpoint, urb.data)})
    if len(found) == 1:
        return found[0]
    if found:
        raise CaptureError(
            f"{path}: several devices have this board's traffic: {', '.join(found)}; choose one with --device"
        )
    raise CaptureError(f"{path}: no device has this board's traffic; {_seen(packets)}")


def _seen(packets: Iterable[Packet]) -> str:
    """Describe the devices and their traffic, for the user's choice."""
    counts: Counter[tuple[str, int]] = Counter()
    for _, urb in packets:
        if urb.transfer == Transfer.BULK and urb.data:
            counts[urb.device, urb.endpoint] += 1
    if not counts:
        return "the file has no bulk transfers with data: was the right bus captured?"
    listed = ", ".join(f"{device} ({n} on endpoint 0x{ep:02x})" for (device, ep), n in sorted(counts.items()))
    return f"bulk transfers in the file: {listed}; choose one with --device"


@dataclass
class _Records:
    """Converts one device's packets to records.

    The packet of a submission has the host's data, the packet of a completion the device's. A message whose transfer
    failed was not delivered.
    """

    start_s: float
    traffic: UsbTraffic
    _records: list[Record] = field(default_factory=list)
    _in_flight: dict[tuple[int, int], int] = field(default_factory=dict)
    """Index of an OUT transfer's record, by number and endpoint, until its completion."""
    _requests: dict[tuple[int, int], bytes] = field(default_factory=dict)
    _jtag: Counter[int] = field(default_factory=Counter)

    def collect(self, packets: Iterable[Packet]) -> list[Record]:
        """Return all records, in the order of the packets."""
        traffic = self.traffic
        for time_s, urb in packets:
            t_s = time_s - self.start_s
            if urb.transfer == Transfer.CONTROL:
                self._control(t_s, urb)
            elif urb.transfer == Transfer.BULK and urb.endpoint in {traffic.endpoint_out, traffic.endpoint_in}:
                (self._answer if urb.endpoint & IN else self._message)(t_s, urb)
            elif urb.endpoint in traffic.programming:
                self._warn_of_jtag(t_s, urb)
        if not traffic.messages:
            return self._records
        whole: list[Record] = attribute(traffic.messages)(self._records)
        return whole

    def _message(self, t_s: float, urb: MonitoredUrb) -> None:
        key = urb.number, urb.endpoint
        if not urb.done:
            if urb.length and not urb.data:
                self._warn(t_s, f"{urb.length} bytes were sent here, but the monitor did not capture them")
                return
            self._in_flight[key] = len(self._records)
            self._records.append(Record(t_s, RecordKind.OUT, urb.endpoint, urb.data))
        elif (place := self._in_flight.pop(key, None)) is not None and urb.failure:
            sent = self._records[place]
            self._records[place] = sent._replace(
                kind=RecordKind.ERROR, text=f"transfer failed: {urb.failure}", of="out"
            )

    def _answer(self, t_s: float, urb: MonitoredUrb) -> None:
        if not urb.done:
            return
        if urb.failure and not urb.data:
            self._records.append(
                Record(t_s, RecordKind.ERROR, urb.endpoint, text=f"transfer failed: {urb.failure}", of="in")
            )
        elif urb.length and not urb.data:
            self._warn(t_s, f"{urb.length} bytes were received here, but the monitor did not capture them")
        else:
            self._records.append(Record(t_s, RecordKind.IN, urb.endpoint, urb.data))

    def _control(self, t_s: float, urb: MonitoredUrb) -> None:
        """Add one record for each transfer: at its submission if the data go to the device, else at its completion."""
        key = urb.number, urb.endpoint & ~IN
        if urb.setup:
            if urb.setup[0] & IN:
                self._requests[key] = urb.setup
            else:
                self._records.append(Record(t_s, RecordKind.CONTROL, 0, urb.data, setup=urb.setup))
        elif urb.done and (setup := self._requests.pop(key, None)) is not None:
            self._records.append(Record(t_s, RecordKind.CONTROL, 0, urb.data, setup=setup))

    def _warn_of_jtag(self, t_s: float, urb: MonitoredUrb) -> None:
        if not self._jtag[urb.endpoint]:
            self._warn(
                t_s,
                f"endpoint 0x{urb.endpoint:02x} programs the FPGA: its transfers are left out, and are never replayed",
            )
        self._jtag[urb.endpoint] += 1

    def _warn(self, t_s: float, text: str) -> None:
        self._records.append(Record(t_s, RecordKind.WARNING, text=text))
