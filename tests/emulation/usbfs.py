"""A USB device file for real libusb: the board behind umockdev's preload library, which redirects a child's ioctls.

The child starts with LD_PRELOAD=libumockdev-preload.so.0 and UMOCKDEV_DIR=<tree>. Sources: the kernel's
`usbdevice_fs.h`, and umockdev's `libumockdev-preload.c`, whose socket protocol is private to it.
"""

import ctypes
import errno
import fcntl
import os
import queue
import shutil
import socket
import struct
import tempfile
import threading
from collections import deque
from contextlib import suppress
from pathlib import Path

from usb_core import UsbCore
from usbip_client import receive

from inteco_abs.mock_board import Urb, UsbSpeed
from inteco_abs.mock_board.usbip.usb_device import SetupPacket

PRELOAD = "libumockdev-preload.so.0"

_MESSAGE = struct.Struct("=QqQ")
_IOCTL, _DONE, _READ_MEMORY, _WRITE_MEMORY = 1, 3, 5, 6
_CAPABILITIES = 0x1F  # scatter-gather among them: each transfer is one URB
_PIPE_SIZE = 1031, 4096  # F_SETPIPE_SZ, one page
_URB = struct.Struct("=BBxxiI4xQii")
_CONTROL_TYPE = 2
_SHORT_NOT_OK, _ZERO_PACKET = 0x01, 0x40


def preload_is_installed():
    """Whether the dynamic loader would find the library; a missing one is only a warning to it."""
    try:
        ctypes.CDLL(PRELOAD)
    except OSError:
        return False
    return True


class Node:
    """One device file. Its FIFO is full, so not writable, while there is nothing to reap: libusb waits for that."""

    def __init__(self, core, path, socket_path, mode):
        self.core = core
        self.path = path
        os.mkfifo(path)
        path.chmod(mode)
        self._fifo = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        fcntl.fcntl(self._fifo, *_PIPE_SIZE)
        os.write(self._fifo, bytes(_PIPE_SIZE[1]))
        self.lock = threading.Lock()
        self._to_reap = 0
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(socket_path))
        socket_path.chmod(0o666)
        self._listener.listen(8)
        self._streams = []
        threading.Thread(target=self._accept, daemon=True).start()

    def finished(self, count):
        """Count what can be reaped up or down; call with the lock held."""
        before, self._to_reap = self._to_reap, self._to_reap + count
        if not before and self._to_reap:
            os.read(self._fifo, _PIPE_SIZE[1])
        elif before and not self._to_reap:
            os.write(self._fifo, bytes(_PIPE_SIZE[1]))

    def close(self):
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        os.close(self._fifo)
        for stream in self._streams:
            stream.close()

    def _accept(self):
        with suppress(OSError):
            while True:
                stream, _ = self._listener.accept()
                self._streams.append(stream)
                threading.Thread(target=Handle(self, stream).serve, daemon=True).start()


class Handle:
    """One open of the device file."""

    def __init__(self, node, stream):
        self._node = node
        self._core = node.core
        self._stream = stream
        self._urbs = {}
        self._buffers = {}
        self._finished = deque()
        self._ioctls = {
            0x8004551A: lambda at: self._write(at, struct.pack("=I", _CAPABILITIES)),
            0x80045505: lambda at: self._core.set_configuration(self._u32(at)),
            0x8004550F: lambda at: self._core.claim(self, self._u32(at)),
            0x80045510: lambda at: self._core.release(self, self._u32(at)),
            0x80085504: lambda at: self._core.set_interface(*struct.unpack("=II", self._read(at, 8))),
            0x80045515: lambda at: self._core.clear_halt(self._u32(at)),
            0x5514: lambda _at: self._core.reset(),
            0x551F: lambda _at: self._core.device.speed,
            0x8038550A: self._submit,
            0x41045508: self._driver,
            0xC0105512: self._driver_ioctl,
            0x8108551B: self._disconnect_and_claim,
        }

    def serve(self):
        with suppress(OSError):
            while len(header := receive(self._stream, _MESSAGE.size)) == _MESSAGE.size:
                kind, request, argument = _MESSAGE.unpack(header)
                if kind == _IOCTL:
                    self._say(_DONE, *self._ioctl(request & 0xFFFFFFFF, argument))
                else:
                    self._say(_DONE, -100)  # reading and writing the node itself: the client's own affair
        for urb in list(self._urbs.values()):
            self._core.bus.cancel(urb)
        with self._node.lock, suppress(OSError):
            self._node.finished(-len(self._finished))
            self._urbs.clear()
            self._finished.clear()
        self._core.close(self)

    def _ioctl(self, request, argument):
        try:
            if request == 0x4008550D:
                return self._reap(argument), 0
            if request == 0x550B:
                return self._discard(argument), 0
            if request not in self._ioctls:
                raise OSError(errno.ENOTTY, f"unknown ioctl {request:#x}")  # noqa: TRY301
            self._core.check_present()
            return self._ioctls[request](argument) or 0, 0
        except OSError as error:
            return -1, error.errno
        except Exception:  # noqa: BLE001 - a client without an answer could not even be interrupted
            return -1, errno.EIO

    def _submit(self, at):
        kind, endpoint, _, flags, buffer, length, _ = _URB.unpack(self._read(at, _URB.size))
        if kind != _CONTROL_TYPE and not self._core.holds(self):
            self._core.claim(self, 0)
        setup, reads = None, endpoint & 0x80
        if kind == _CONTROL_TYPE:
            setup = SetupPacket.unpack(self._read(buffer, 8))
            reads, buffer, length, endpoint = setup.reads, buffer + 8, length - 8, 0x80 * setup.reads
        urb = Urb(
            endpoint,
            lambda _urb: self._completed(at),
            data=b"" if reads else self._read(buffer, length),
            length=length if reads else 0,
            setup=setup,
            short_not_ok=bool(flags & _SHORT_NOT_OK),
            zero_packet=bool(flags & _ZERO_PACKET),
        )
        self._urbs[at] = urb
        self._buffers[at] = buffer
        try:
            self._core.bus.submit(urb)
        except OSError:
            del self._urbs[at]
            raise

    def _completed(self, at):
        with self._node.lock:
            if at in self._urbs:
                self._finished.append(at)
                with suppress(OSError):
                    self._node.finished(1)

    def _reap(self, argument):
        with self._node.lock:
            if not self._finished:
                gone = not self._core.present and not self._urbs
                raise OSError(errno.ENODEV if gone else errno.EAGAIN, "nothing to reap")
            at = self._finished.popleft()
            urb, buffer = self._urbs.pop(at), self._buffers.pop(at)
            self._node.finished(-1)
        if urb.received:
            self._write(buffer, bytes(urb.received))
        self._write(at + 4, struct.pack("=i", urb.status))
        self._write(at + 28, struct.pack("=i", urb.actual))
        self._write(argument, struct.pack("=Q", at))
        return 0

    def _discard(self, at):
        urb = self._urbs.get(at)
        if urb is None or not self._core.bus.cancel(urb):
            raise OSError(errno.EINVAL, "not in flight")
        return 0

    def _driver(self, at):
        name = self._core.driver or ("usbfs" if self._core.claimed else None)
        if name is None:
            raise OSError(errno.ENODATA, "no driver")
        self._write(at + 4, name.encode().ljust(256, b"\0"))

    def _driver_ioctl(self, at):
        _, code, _ = struct.unpack("=iiQ", self._read(at, 16))
        if code == 0x5516:
            return self._core.detach_driver()
        if code == 0x5517:
            self._core.attach_driver()
            return int(self._core.driver is not None)
        raise OSError(errno.ENOTTY, "unknown")

    def _disconnect_and_claim(self, at):
        self._core.driver = None
        self._core.claim(self, self._u32(at))

    def _u32(self, at):
        return struct.unpack("=I", self._read(at, 4))[0]

    def _read(self, at, count):
        if not count:
            return b""
        self._say(_READ_MEMORY, at, count)
        return receive(self._stream, count)

    def _write(self, at, data):
        self._stream.sendall(_MESSAGE.pack(_WRITE_MEMORY, at, len(data)) + data)

    def _say(self, *words):
        self._stream.sendall(_MESSAGE.pack(*words, *(0,) * (3 - len(words))))


class UsbfsTree:
    """The folders that a child with the preload library takes for /dev and /sys; follows plugging and unplugging."""

    def __init__(self, host, mode=0o666, driver=None):
        self.path = Path(tempfile.mkdtemp(prefix="u", dir="/tmp"))
        self.path.chmod(0o755)
        self._host = host
        self._mode = mode
        self._driver = driver
        self._nodes = []
        self._serial = 0
        for folder in ("dev/bus/usb/001", "ioctl/dev/bus/usb/001", "sys/bus/usb/devices", "sys/class", "run"):
            (self.path / folder).mkdir(parents=True)
        (self.path / "sys/devices/usb1").mkdir(parents=True)
        # an event socket of a client that is not root must find room here
        self.path.chmod(0o777)
        self._add()
        self._changes = queue.Queue()
        host.listeners.append(self._changes.put)
        self._worker = threading.Thread(target=self._follow)
        self._worker.start()

    def environment(self):
        return {"LD_PRELOAD": PRELOAD, "UMOCKDEV_DIR": str(self.path)}

    def close(self):
        self._host.listeners.remove(self._changes.put)
        self._changes.put(None)
        self._worker.join(10)
        for node in self._nodes:
            node.close()
        shutil.rmtree(self.path)

    def _follow(self):
        while (plugged := self._changes.get()) is not None:
            if plugged:
                self._add()
            else:
                self._remove()
            self._tell("add" if plugged else "remove")

    @property
    def _name(self):
        return f"{self._nodes[-1].core.address:03}"

    def _properties(self, device_name):
        address = self._nodes[-1].core.address
        return {
            "DRIVER": "usb",
            "BUSNUM": "001",
            "DEVNUM": self._name,
            "DEVNAME": f"{device_name}/{self._name}",
            "DEVTYPE": "usb_device",
            "MAJOR": "189",
            "MINOR": str(address - 1),
        }

    def _add(self):
        core = UsbCore(self._host, driver=self._driver)
        name = f"{core.address:03}"
        places = (self.path / "dev/bus/usb/001" / name, self.path / "ioctl/dev/bus/usb/001" / name)
        node = Node(core, *places, self._mode)
        self._nodes.append(node)
        folder = self.path / "sys/devices/usb1/1-1"
        folder.mkdir()
        uevent = "".join(f"{key}={value}\n" for key, value in self._properties("bus/usb/001").items())
        speed = {UsbSpeed.FULL: "12", UsbSpeed.HIGH: "480"}[self._host.device.identity.speed]
        texts = {"uevent": uevent, "busnum": "1\n", "devnum": f"{core.address}\n", "speed": f"{speed}\n"}
        for file, text in texts.items():
            (folder / file).write_text(text)
        configured = folder / "bConfigurationValue"
        configured.write_text(f"{core.configuration}\n")
        core.on_configuration = lambda value: configured.write_text(f"{value}\n" if value else "\n")
        (folder / "descriptors").write_bytes(core.descriptors)
        (folder / "subsystem").symlink_to("../../../bus/usb")
        (self.path / "sys/bus/usb/devices/1-1").symlink_to("../../../devices/usb1/1-1")

    def _remove(self):
        (self.path / "sys/bus/usb/devices/1-1").unlink()
        shutil.rmtree(self.path / "sys/devices/usb1/1-1")
        self._nodes[-1].path.unlink()

    def _tell(self, action):
        """What udev would send to its listeners."""
        self._serial += 1
        texts = {
            "ACTION": action,
            "SEQNUM": str(self._serial),
            "SUBSYSTEM": "usb",
            "DEVPATH": "/devices/usb1/1-1",
            **self._properties("/dev/bus/usb/001"),
        }
        properties = b"".join(f"{key}={value}".encode() + b"\0" for key, value in texts.items())
        header = b"libudev\0" + struct.pack(">I", 0xFEEDCAFE) + struct.pack("=III", 40, 40, len(properties))
        header += struct.pack(">II", murmur2(b"usb"), murmur2(b"usb_device")) + bytes(8)
        for listener in self.path.glob("event*"):
            with socket.socket(socket.AF_UNIX, socket.SOCK_RAW) as sender, suppress(OSError):
                sender.sendto(header + properties, str(listener))


def murmur2(data):
    """MurmurHash2 with seed 0, by which udev's listeners filter."""
    factor, mask = 0x5BD1E995, 0xFFFFFFFF
    state = len(data)
    for at in range(0, len(data) - 3, 4):
        word = int.from_bytes(data[at : at + 4], "little") * factor & mask
        word = (word ^ word >> 24) * factor & mask
        state = state * factor & mask ^ word
    rest = data[len(data) & ~3 :]
    if rest:
        state = (state ^ int.from_bytes(rest, "little")) * factor & mask
    state = (state ^ state >> 13) * factor & mask
    return state ^ state >> 15
