"""A bus at the far end of a USB/IP connection, with message layouts of its own: the server's are what is tested."""

import errno
import socket
import struct
import threading
from contextlib import suppress

VERSION = 0x0111
IMPORT = struct.pack(">HHI", VERSION, 0x8003, 0)
RECORD_BYTES = 312


def connect(address):
    """A stream to a (host, port), or to the path of a Unix socket."""
    if isinstance(address, tuple):
        return socket.create_connection(address, timeout=10)
    stream = socket.socket(socket.AF_UNIX)
    stream.settimeout(10)
    stream.connect(str(address))
    return stream


def receive(stream, count):
    """Exactly `count` bytes; fewer only at the end of the stream."""
    data = b""
    while len(data) < count and (more := stream.recv(count - len(data))):
        data += more
    return data


class UsbIpBus:
    def __init__(self, address, bus_id=b"1-1"):
        self._stream = connect(address)
        if isinstance(address, tuple):
            self._stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._stream.sendall(IMPORT + bus_id.ljust(32, b"\0"))
        reply = receive(self._stream, 8)
        if reply != struct.pack(">HHI", VERSION, 3, 0):
            self._stream.close()
            raise ConnectionRefusedError("the import was refused")
        bus, self.address = struct.unpack_from(">II", receive(self._stream, RECORD_BYTES), 288)
        self._device_id = bus << 16 | self.address
        self._stream.settimeout(None)
        self.plugged = True
        self._sequence = 0
        self._in_flight = {}
        self._unlinking = {}
        self._lock = threading.Lock()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def submit(self, urb):
        reads = bool(urb.endpoint & 0x80)
        flags = 0x01 * urb.short_not_ok | 0x40 * urb.zero_packet
        setup = urb.setup.pack() if urb.setup else bytes(8)
        length = urb.length if reads else len(urb.data)
        with self._lock:
            if not self.plugged:
                raise OSError(errno.ENODEV, "the device has gone")
            self._sequence += 1
            self._in_flight[self._sequence] = urb
            self._send(1, reads, urb.endpoint & 0x0F, struct.pack(">IiiII8s", flags, length, 0, 0, 0, setup), urb.data)

    def cancel(self, urb):
        with self._lock:
            for victim, waiting in self._in_flight.items():
                if waiting is urb:
                    self._sequence += 1
                    self._unlinking[self._sequence] = victim
                    self._send(2, False, 0, struct.pack(">I24x", victim))
                    return True
        return False

    def close(self):
        """Detach, as the kernel does: without a word."""
        with suppress(OSError):
            self._stream.shutdown(socket.SHUT_RDWR)
        self._reader.join(10)
        self._stream.close()

    def _send(self, command, reads, endpoint, body, data=b""):
        header = struct.pack(">IIIII", command, self._sequence, self._device_id, reads, endpoint)
        with suppress(OSError):  # the reader sees the end
            self._stream.sendall(header + body + data)

    def _read(self):
        try:
            while len(header := receive(self._stream, 48)) == 48:
                self._returned(*struct.unpack(">IIIIIii20x", header))
        except OSError:
            pass
        with self._lock:
            self.plugged = False
            left, self._in_flight = self._in_flight, {}
        for urb in left.values():
            self._finish(urb, -errno.ESHUTDOWN)

    def _returned(self, command, sequence, _device, _direction, _endpoint, status, actual):
        if command == 3:
            with self._lock:
                urb = self._in_flight.pop(sequence)  # KeyError: the kernel would hang up too
            if urb.endpoint & 0x80:
                urb.received += receive(self._stream, actual)
            else:
                urb.sent = actual
            self._finish(urb, status)
            return
        assert command == 4
        with self._lock:
            victim = self._unlinking.pop(sequence)
            urb = self._in_flight.pop(victim) if status else None
            assert status or victim not in self._in_flight, "a late unlink came before the answer"
        if urb is not None:
            self._finish(urb, status)

    @staticmethod
    def _finish(urb, status):
        urb.status = status
        urb.complete(urb)
