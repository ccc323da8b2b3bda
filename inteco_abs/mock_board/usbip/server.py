"""The mock board for any Linux: a USB/IP server, whose board the kernel's `vhci_hcd` makes into a real USB device.

USB/IP has neither password nor encryption, so the server stays on the loopback address unless told otherwise.
Sources: the kernel's `Documentation/usb/usbip_protocol.rst` and `drivers/usb/usbip/vhci_rx.c`.
"""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, NamedTuple

from inteco_abs.errors import BoardError
from inteco_abs.mock_board.usbip.address import USBIP_PORT, TcpAddress, UnixAddress
from inteco_abs.mock_board.usbip.attachment import Attachment
from inteco_abs.mock_board.usbip.connection import Connection
from inteco_abs.mock_board.usbip.messages import (
    DeviceRecord,
    DevicesRequest,
    MalformedError,
    devices_reply,
    import_reply,
    take_command,
    take_request,
)
from inteco_abs.mock_board.usbip.usb_descriptors import Speed
from inteco_abs.mock_board.usbip.usb_host import UsbHost

BUS: Final = 1
BUS_ID: Final = "1-1"
_PATH: Final = b"/sys/devices/inteco-abs-mock/usb1/1-1"
_SPEEDS: Final = {Speed.FULL: 2, Speed.HIGH: 3}
_ANYWHERE: Final = ("", "0.0.0.0", "::")  # noqa: S104

_CATCH_UP_S: Final = 0.001
"""The rig moves on this often while a host is there."""
_IDLE_S: Final = 0.01
_PATIENCE_S: Final = 10.0
"""A visitor that has not said by then what it wants has to go."""
_MOST_VISITORS: Final = 16


class AttachFacts(NamedTuple):
    """What somebody needs who wants to attach the board."""

    bus_id: str
    vendor_id: int
    product_id: int
    serial: int
    speed: str
    """"full" or "high"."""
    address: TcpAddress | UnixAddress
    """Where the server listens, with the port it really has."""
    attach: tuple[str, ...]
    """Commands, to be run as root; none for a Unix socket, which `usbip` cannot reach."""
    detach: tuple[str, ...]


class UsbIpServer:
    """Offers the device of `host` at `address`: `bind`, then `serve` until `close`; or `step` in one's own loop.

    One import at a time; the next is accepted after a detach. Whoever sends what is not a message is hung up on and
    counted in `malformed`. The outputs stay as they are when a peer leaves, as no RT-DAC board is known to do
    anything else.
    """

    def __init__(self, host: UsbHost, address: TcpAddress | UnixAddress | None = None) -> None:
        self.malformed = 0
        self._host = host
        self._address = address or TcpAddress()
        self._listener: socket.socket | None = None
        self._visitors: dict[Connection, float] = {}  # with the time at which patience ends
        self._importer: Connection | None = None
        self._attachment: Attachment | None = None
        self._bell: socket.socket | None = None
        self._rope: socket.socket | None = None
        self._lock = threading.RLock()  # `close` may be called by a signal handler in the middle of `serve`
        self._serving = False
        self._closed = False
        host.listeners.append(self._plugged)

    @property
    def busy(self) -> bool:
        """Whether the board is imported."""
        return self._importer is not None

    def bind(self) -> AttachFacts:
        """Listen from now on. Raises BoardError if the address is taken."""
        self._listener = self._address.listen()
        self._listener.setblocking(False)
        self._bell, self._rope = socket.socketpair()
        if isinstance(self._address, TcpAddress):
            self._address = self._address._replace(port=self._listener.getsockname()[1])
        return self.facts

    @property
    def facts(self) -> AttachFacts:
        """What to tell the user."""
        identity, address = self._host.device.identity, self._address
        attach: tuple[str, ...] = ()
        detach: tuple[str, ...] = ()
        if isinstance(address, TcpAddress):
            name = socket.gethostname() if address.host in _ANYWHERE else address.host
            usbip = "usbip" if address.port == USBIP_PORT else f"usbip --tcp-port {address.port}"
            attach = ("modprobe vhci-hcd", f"{usbip} attach -r {name} -b {BUS_ID}")
            detach = ("usbip port", "usbip detach -p 00")
        return AttachFacts(
            BUS_ID,
            identity.vendor_id,
            identity.product_id,
            identity.serial,
            identity.speed.name.lower(),
            address,
            attach,
            detach,
        )

    def serve(self, each_step: Callable[[], None] = lambda: None) -> None:
        """Serve until `close` is called or an exception such as KeyboardInterrupt ends it; then hang up on all.

        `each_step` is called some hundred times a second.
        """
        with self._lock:
            self._serving = not self._closed
        try:
            while not self._closed:
                self.step()
                each_step()
        finally:
            self._hang_up()

    def close(self) -> None:
        """End `serve`, from any thread or signal handler; whoever has the board sees an unplug."""
        with self._lock:
            self._closed = True
            serving = self._serving
        if serving:
            if self._rope is not None:
                with suppress(OSError):
                    self._rope.send(b"!")
        else:
            self._hang_up()

    def step(self) -> None:
        """Wait a moment for something to do, and do it."""
        if self._listener is None or self._bell is None:
            raise BoardError("the USB/IP server must be bound to its address before it can serve")
        peers = [*self._visitors, *([self._importer] if self._importer else [])]
        reading: list[socket.socket | Connection] = [self._listener, self._bell]
        reading += [peer for peer in peers if not peer.closing]
        writing = [peer for peer in peers if peer.unsent]
        patience_s = min(_CATCH_UP_S, self._host.device.due_s) if self.busy else _IDLE_S
        ready, writable, _ = select.select(reading, writing, [], patience_s)
        for peer in writable:
            peer.flush()
        for peer in peers:  # before the listener: a peer that has left makes room for the one that comes
            if peer in ready:
                self._listen_to(peer)
        if self._listener in ready:
            self._welcome(self._listener)
        self._part()
        self._host.catch_up()

    def _welcome(self, listener: socket.socket) -> None:
        try:
            peer, _ = listener.accept()
        except OSError:
            return  # gone again
        if len(self._visitors) < _MOST_VISITORS:
            self._visitors[Connection(peer)] = time.monotonic() + _PATIENCE_S
        else:
            peer.close()

    def _listen_to(self, peer: Connection) -> None:
        there = peer.receive()
        try:
            if peer is not self._importer:
                self._answer(peer)
            if peer is self._importer and self._attachment is not None:
                while (command := take_command(peer.arrived)) is not None:
                    self._attachment.handle(command)
        except MalformedError:
            self.malformed += 1
            there = False
        if not there:
            self._drop(peer)

    def _answer(self, visitor: Connection) -> None:
        request = take_request(visitor.arrived)
        if request is None:
            return
        if isinstance(request, DevicesRequest):
            found = [(self._record(), [self._host.device.identity.interface_class])] if self._host.plugged else []
            visitor.send(devices_reply(found))
            visitor.closing = True
        elif request.bus_id == BUS_ID.encode() and self._host.plugged and not self.busy:
            self._import(visitor)
        else:
            visitor.send(import_reply(None))
            visitor.closing = True

    def _import(self, visitor: Connection) -> None:
        del self._visitors[visitor]
        self._host.reset()
        record = self._record()
        self._attachment = Attachment(self._host, record.bus << 16 | record.device, visitor.send)
        self._importer = visitor
        visitor.send(import_reply(record))
        if not self._host.plugged:  # unplugged by another thread in this very moment
            visitor.cut()

    def _record(self) -> DeviceRecord:
        device = self._host.device
        identity = device.identity
        return DeviceRecord(
            _PATH,
            BUS_ID.encode(),
            BUS,
            self._host.address,
            _SPEEDS[identity.speed],
            identity.vendor_id,
            identity.product_id,
            identity.release,
            *identity.device_class,
            device.configuration,
            1,
            1,
        )

    def _plugged(self, plugged: bool) -> None:
        importer = self._importer
        if importer is not None and not plugged:
            importer.cut()

    def _part(self) -> None:
        now = time.monotonic()
        for visitor, until in list(self._visitors.items()):
            if now > until or (visitor.closing and not visitor.unsent):
                self._drop(visitor)

    def _drop(self, peer: Connection) -> None:
        if peer is self._importer:
            if self._attachment is not None:
                self._attachment.end()
            self._importer = self._attachment = None
        self._visitors.pop(peer, None)
        peer.cut()
        peer.close()

    def _hang_up(self) -> None:
        with suppress(ValueError):
            self._host.listeners.remove(self._plugged)
        for peer in [*self._visitors, *([self._importer] if self._importer else [])]:
            self._drop(peer)
        for own in (self._listener, self._bell, self._rope):
            if own is not None:
                own.close()
        if isinstance(self._address, UnixAddress) and self._listener is not None:
            self._address.path.unlink(missing_ok=True)
        self._listener = None
