"""Exports the mock board over USB/IP, so that the kernel's `vhci_hcd` on any Linux can attach it as a USB device.

USB/IP has neither password nor encryption, so the server listens on the loopback address by default.
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
from inteco_abs.mock_board.usbip.usb_descriptors import UsbSpeed
from inteco_abs.mock_board.usbip.usb_host import UsbHost

BUS: Final = 1
BUS_ID: Final = "1-1"
_PATH: Final = b"/sys/devices/inteco-abs-mock/usb1/1-1"
_SPEEDS: Final = {UsbSpeed.FULL: 2, UsbSpeed.HIGH: 3}
_ANYWHERE: Final = ("", "0.0.0.0", "::")  # noqa: S104

_CATCH_UP_S: Final = 0.001
"""Interval at which the rig advances while the board is imported."""
_IDLE_S: Final = 0.01
_REQUEST_TIMEOUT_S: Final = 10.0
"""Time for a client to send its request."""
_MOST_CLIENTS: Final = 16


class AttachFacts(NamedTuple):
    """Facts for attaching the board to a computer."""

    bus_id: str
    vendor_id: int
    product_id: int
    serial: int
    speed: str
    """"full" or "high"."""
    address: TcpAddress | UnixAddress
    """Address of the server, with its actual port."""
    attach: tuple[str, ...]
    """Commands to run as root; none for a Unix socket, which `usbip` cannot reach."""
    detach: tuple[str, ...]


class UsbIpServer:
    """Exports the device of `host` at `address`: call `bind`, then `serve`, which ends at `close`, or `step` in a loop.

    It accepts one import at a time. A peer that sends malformed bytes is disconnected and counted in `malformed`.
    Outputs stay when a peer leaves, as on every known RT-DAC board.
    """

    def __init__(self, host: UsbHost, address: TcpAddress | UnixAddress | None = None) -> None:
        self.malformed = 0
        self._host = host
        self._address = address or TcpAddress()
        self._listener: socket.socket | None = None
        self._clients: dict[Connection, float] = {}  # with their deadline, monotonic s
        self._importer: Connection | None = None
        self._attachment: Attachment | None = None
        self._wake_receiver: socket.socket | None = None
        self._wake_sender: socket.socket | None = None
        self._lock = threading.RLock()  # `close` may be called by a signal handler in the middle of `serve`
        self._serving = False
        self._closed = False
        host.listeners.append(self._plugged)

    @property
    def busy(self) -> bool:
        """Whether the board is imported."""
        return self._importer is not None

    def bind(self) -> AttachFacts:
        """Start to listen. Raises BoardError if the address is in use."""
        self._listener = self._address.listen()
        self._listener.setblocking(False)
        self._wake_receiver, self._wake_sender = socket.socketpair()
        if isinstance(self._address, TcpAddress):
            self._address = self._address._replace(port=self._listener.getsockname()[1])
        return self.facts

    @property
    def facts(self) -> AttachFacts:
        """Facts for attaching the board."""
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
        """Serve until `close` or an exception such as KeyboardInterrupt; then disconnect all peers.

        Calls `each_step` some hundred times a second.
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
        """End `serve`, from any thread or signal handler; for the importer it is an unplug."""
        with self._lock:
            self._closed = True
            serving = self._serving
        if serving:
            if self._wake_sender is not None:
                with suppress(OSError):
                    self._wake_sender.send(b"!")
        else:
            self._hang_up()

    def step(self) -> None:
        """Serve once, after a short wait."""
        if self._listener is None or self._wake_receiver is None:
            raise BoardError("the USB/IP server must be bound to its address before it can serve")
        peers = self._peers()
        reading: list[socket.socket | Connection] = [self._listener, self._wake_receiver]
        reading += [peer for peer in peers if not peer.closing]
        writing = [peer for peer in peers if peer.unsent]
        timeout_s = min(_CATCH_UP_S, self._host.device.due_s) if self.busy else _IDLE_S
        ready, writable, _ = select.select(reading, writing, [], timeout_s)
        for peer in writable:
            peer.flush()
        for peer in peers:  # before the listener: a peer that has left makes room for the next
            if peer in ready:
                self._receive(peer)
        if self._listener in ready:
            self._accept(self._listener)
        self._drop_finished()
        self._host.catch_up()

    def _peers(self) -> list[Connection]:
        return [*self._clients, *([self._importer] if self._importer else [])]

    def _accept(self, listener: socket.socket) -> None:
        try:
            peer, _ = listener.accept()
        except OSError:
            return  # gone again
        if len(self._clients) < _MOST_CLIENTS:
            self._clients[Connection(peer)] = time.monotonic() + _REQUEST_TIMEOUT_S
        else:
            peer.close()

    def _receive(self, peer: Connection) -> None:
        connected = peer.receive()
        try:
            if peer is not self._importer:
                self._answer(peer)
            if peer is self._importer and self._attachment is not None:
                while (command := take_command(peer.arrived)) is not None:
                    self._attachment.handle(command)
        except MalformedError:
            self.malformed += 1
            connected = False
        if not connected:
            self._drop(peer)

    def _answer(self, client: Connection) -> None:
        request = take_request(client.arrived)
        if request is None:
            return
        if isinstance(request, DevicesRequest):
            found = [(self._record(), [self._host.device.identity.interface_class])] if self._host.plugged else []
            client.send(devices_reply(found))
            client.closing = True
        elif request.bus_id == BUS_ID.encode() and self._host.plugged and not self.busy:
            self._import(client)
        else:
            client.send(import_reply(None))
            client.closing = True

    def _import(self, client: Connection) -> None:
        del self._clients[client]
        self._host.reset()
        record = self._record()
        self._attachment = Attachment(self._host, record.bus << 16 | record.device, client.send)
        self._importer = client
        client.send(import_reply(record))
        if not self._host.plugged:  # another thread has just unplugged it
            client.cut()

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

    def _drop_finished(self) -> None:
        now = time.monotonic()
        for client, deadline in list(self._clients.items()):
            if now > deadline or (client.closing and not client.unsent):
                self._drop(client)

    def _drop(self, peer: Connection) -> None:
        if peer is self._importer:
            if self._attachment is not None:
                self._attachment.end()
            self._importer = self._attachment = None
        self._clients.pop(peer, None)
        peer.cut()
        peer.close()

    def _hang_up(self) -> None:
        with suppress(ValueError):
            self._host.listeners.remove(self._plugged)
        for peer in self._peers():
            self._drop(peer)
        for own in (self._listener, self._wake_receiver, self._wake_sender):
            if own is not None:
                own.close()
        if isinstance(self._address, UnixAddress) and self._listener is not None:
            self._address.path.unlink(missing_ok=True)
        self._listener = None
