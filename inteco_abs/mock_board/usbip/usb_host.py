"""The host's side of the bus: requests (URBs) in one queue per endpoint, moved packet by packet to and from a device.

It has the interface of the kernel's USB core, with its status numbers: 0, or a negative errno.
Source: the kernel's `Documentation/driver-api/usb/error-codes.rst`.
"""

from __future__ import annotations

import errno
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from inteco_abs.mock_board.usbip.usb_descriptors import ENDPOINT_DIRECTION_IN
from inteco_abs.mock_board.usbip.usb_device import Handshake, SetupPacket, UsbDevice

_FIRST_ADDRESS: Final = 2
"""First device number; 1 is the root hub."""


@dataclass(eq=False, slots=True)
class Urb:
    """One transfer. The caller sets its parameters, the host its result.

    `endpoint` is an address, with 0x80 for IN; 0 is control and needs `setup`. `length` is the room for IN data in
    bytes. `complete` is called once, when `status` is final, from the thread that ended the transfer.
    """

    endpoint: int
    complete: Callable[[Urb], None]
    data: bytes = b""
    """OUT data."""
    length: int = 0
    setup: SetupPacket | None = None
    short_not_ok: bool = False
    """Less IN data than `length` is an error, -EREMOTEIO."""
    zero_packet: bool = False
    """An empty packet follows OUT data that end in a full one."""

    status: int | None = None
    """None while in flight, then 0 or a negative errno."""
    received: bytearray = field(default_factory=bytearray)
    sent: int = 0
    packets: deque[bytes] = field(default_factory=deque)
    """OUT packets that the device has not accepted yet; internal to the host."""

    @property
    def actual(self) -> int:
        """Number of bytes transferred, also after an error."""
        return len(self.received) or self.sent

    @property
    def queue(self) -> int:
        """Number of its queue; control transfers have one for both directions."""
        return self.endpoint if self.endpoint & ~ENDPOINT_DIRECTION_IN else 0


class UsbHost:
    """One port with `device` plugged in. Thread-safe.

    Completions and listeners run outside the lock, one at a time and in order. They may call the host again.
    """

    def __init__(self, device: UsbDevice) -> None:
        self.device = device
        self.address = _FIRST_ADDRESS
        """Number of the device on its bus; changes each time it is plugged in."""
        self.plugged = True
        self.listeners: list[Callable[[bool], None]] = []
        """Called after the device is plugged in (True) or unplugged (False)."""
        self._lock = threading.RLock()
        self._queues: dict[int, deque[Urb]] = {}
        self._faults: dict[int, deque[int]] = {}
        self._deliveries: deque[Callable[[], None]] = deque()
        self._running = False
        self._again = False
        device.on_ready = self._run

    def submit(self, urb: Urb) -> None:
        """Queue a transfer. Raises OSError: ENODEV when unplugged, ENOENT for an endpoint that does not exist."""
        with self._lock:
            if not self.plugged:
                raise OSError(errno.ENODEV, "the device is unplugged")
            if urb.queue not in (0, *self.device.endpoints):
                raise OSError(errno.ENOENT, f"there is no endpoint {urb.endpoint:#04x}")
            if urb.queue and not urb.endpoint & ENDPOINT_DIRECTION_IN:
                urb.packets.extend(self._split(urb))
            self._queues.setdefault(urb.queue, deque()).append(urb)
        self._run()

    def cancel(self, urb: Urb) -> bool:
        """End a transfer with -ENOENT, keeping its received bytes; return False if it had already ended."""
        with self._lock:
            if urb.status is not None:
                return False
            self._queues[urb.queue].remove(urb)
            self._finish(urb, -errno.ENOENT)
        self._run()
        return True

    def inject(self, endpoint: int, status: int) -> None:
        """End the next transfer on `endpoint` (0 for control) with `status`, such as -EPROTO, without data."""
        with self._lock:
            self._faults.setdefault(endpoint, deque()).append(status)
        self._run()

    def reset(self) -> None:
        """Reset the bus: unconfigure the device and end transfers in flight with -EPROTO."""
        with self._lock:
            self._flush(-errno.EPROTO)
            self.device.reset()
        self._run()

    def unplug(self) -> None:
        """Unplug the device: transfers in flight end with -ESHUTDOWN."""
        with self._lock:
            if not self.plugged:
                return
            self.plugged = False
            self._faults.clear()
            self._flush(-errno.ESHUTDOWN)
            self._notify(plugged=False)
        self._run()

    def plug(self) -> None:
        """Plug the device in again, unconfigured and with a new number."""
        with self._lock:
            if self.plugged:
                return
            self.plugged = True
            self.address += 1
            self.device.reset()
            self._notify(plugged=True)
        self._run()

    def catch_up(self) -> None:
        """Let the device use idle time, then ask it again, as a timer may have made data available."""
        with self._lock:
            self.device.catch_up()
        self._run()

    def _split(self, urb: Urb) -> list[bytes]:
        size = self.device.identity.speed.packet_bytes
        packets = [urb.data[at : at + size] for at in range(0, len(urb.data), size)]
        if not packets or (urb.zero_packet and len(packets[-1]) == size):
            packets.append(b"")
        return packets

    def _notify(self, *, plugged: bool) -> None:
        for listener in self.listeners:
            self._deliveries.append(partial(listener, plugged))

    def _flush(self, status: int) -> None:
        for queue in self._queues.values():
            while queue:
                self._finish(queue.popleft(), status)

    def _finish(self, urb: Urb, status: int) -> None:
        urb.status = status
        self._deliveries.append(partial(urb.complete, urb))

    def _run(self) -> None:
        """Move packets and run completions until nothing moves; a nested call only requests another round."""
        with self._lock:
            self._again = True
            if self._running:
                return
            self._running = True
        try:
            while (delivery := self._next_delivery()) is not None:
                delivery()
        except BaseException:
            self._running = False
            raise

    def _next_delivery(self) -> Callable[[], None] | None:
        with self._lock:
            while not self._deliveries:
                if not self._again:
                    self._running = False
                    return None
                self._again = False
                for queue in list(self._queues.values()):
                    self._serve(queue)
            return self._deliveries.popleft()

    def _serve(self, queue: deque[Urb]) -> None:
        while queue:
            urb = queue[0]
            faults = self._faults.get(urb.queue)
            status = faults.popleft() if faults else self._move(urb)
            if urb.status is not None:
                continue  # the transfer has unplugged the device
            if status is None:
                return
            queue.popleft()
            self._finish(urb, status)

    def _move(self, urb: Urb) -> int | None:
        """Exchange packets for `urb` until it ends; return its status, or None while the device answers NAK."""
        if urb.setup is not None:
            return self._control(urb, urb.setup)
        return self._in(urb) if urb.endpoint & ENDPOINT_DIRECTION_IN else self._out(urb)

    def _control(self, urb: Urb, setup: SetupPacket) -> int | None:
        answer = self.device.control(setup, urb.data)
        if answer is Handshake.NAK:
            return None
        if answer is Handshake.STALL:
            return -errno.EPIPE
        if not isinstance(answer, bytes):
            urb.sent = len(urb.data)
            return 0
        return self._receive(urb, answer, ends=True)

    def _in(self, urb: Urb) -> int | None:
        status = None
        while status is None:
            packet = self.device.packet_in(urb.endpoint)
            if not isinstance(packet, bytes):
                return -errno.EPIPE if packet is Handshake.STALL else None
            status = self._receive(urb, packet, ends=len(packet) < self.device.identity.speed.packet_bytes)
        return status

    @staticmethod
    def _receive(urb: Urb, packet: bytes, *, ends: bool) -> int | None:
        room = urb.length - len(urb.received)
        urb.received += packet[:room]
        if len(packet) > room:
            return -errno.EOVERFLOW
        if len(packet) == room:
            return 0
        if ends:
            return -errno.EREMOTEIO if urb.short_not_ok else 0
        return None

    def _out(self, urb: Urb) -> int | None:
        while urb.packets:
            answer = self.device.packet_out(urb.endpoint, urb.packets[0])
            if answer is not Handshake.ACK:
                return -errno.EPIPE if answer is Handshake.STALL else None
            urb.sent += len(urb.packets.popleft())
        return 0
