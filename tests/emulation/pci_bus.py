"""An RT-DAC4/PCI as Linux shows it under /sys: files, and behind the one with the registers a live board.

Plain files cannot answer pairs of index and data, so the double stands where the calls enter the kernel: `os.pread`
and `os.pwrite` of the registers' file go to the mock, those of all other files to the system.
"""

import errno
import os
from pathlib import Path

from firmware_protocol.register_messages import encode_request
from firmware_protocol.registers import Write
from inteco_abs.errors import LinkError

ADDRESS = "0000:03:0a.0"
IO_PORTS = 0x40101
MEMORY = 0x40200


def add_board(root, address=ADDRESS, *, flags=IO_PORTS, start=0xD400, size=256, **files):
    """Folder of one more board under `root`; `files` differ from those of a good one, None: is not there."""
    folder = Path(root) / "bus/pci/devices" / address
    folder.mkdir(parents=True)
    none = f"0x{0:016x} 0x{0:016x} 0x{0:016x}\n"
    bar = f"0x{start:016x} 0x{start + size - 1:016x} 0x{flags:016x}\n" if size else none
    content = {
        "vendor": b"0x10b5\n",
        "device": b"0x2497\n",
        "enable": b"1\n",
        "resource": f"{none}{none}{bar}{none * 10}".encode(),
        "resource2": bytes(size),
        **files,
    }
    for name, data in content.items():
        if data is not None:
            (folder / name).write_bytes(data)
    return folder


class LiveRegisters:
    """The double of both calls. `connect` puts a link to a mock behind a folder's registers."""

    def __init__(self, pread=os.pread, pwrite=os.pwrite):
        self._pread, self._pwrite = pread, pwrite
        self._links = {}
        self._number = 0

    def connect(self, folder, link):
        found = (folder / "resource2").stat()
        self._links[found.st_dev, found.st_ino] = link

    def pread(self, fd, length, offset):
        link = self._link(fd)
        if link is None:
            return self._pread(fd, length, offset)
        assert length == 4
        return _as_kernel(lambda: self._ask(link, offset))[4:]

    def pwrite(self, fd, data, offset):
        link = self._link(fd)
        if link is None:
            return self._pwrite(fd, data, offset)
        assert len(data) == 4
        _as_kernel(lambda: self._send(link, Write(offset, int.from_bytes(data, "little"))))
        return len(data)

    def _link(self, fd):
        found = os.fstat(fd)
        return self._links.get((found.st_dev, found.st_ino))

    def _ask(self, link, offset):
        self._send(link, offset)
        while True:  # a call that a test broke into has left its answer behind; in a kernel there is no such thing
            answer = link.read(8)
            if len(answer) < 4 or int.from_bytes(answer[:4], "little") == self._number:
                return answer

    def _send(self, link, step):
        self._number += 1
        link.write(encode_request(self._number, [step]))


def _as_kernel(call):
    try:
        return call()
    except LinkError as error:
        raise OSError(errno.ENXIO, str(error)) from error
