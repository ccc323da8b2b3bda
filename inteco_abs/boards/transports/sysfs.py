"""Registers of a board on the PCI bus, through the files of Linux under /sys."""

from __future__ import annotations

import errno
import mmap
import os
from pathlib import Path
from typing import Final

from firmware_protocol.registers import REGISTER_BYTES
from firmware_protocol.rtdac_pci import BAR_BYTES, BAR_INDEX, DEVICE_ID, VENDOR_ID
from inteco_abs.boards.transports.registers import Registers
from inteco_abs.errors import BoardError, LinkError
from inteco_abs.posix import fcntl, require_linux

_IO, _MEMORY = 0x100, 0x200
"""Kinds of a base address register, in the third column of the file `resource` (linux/ioport.h)."""
_REGISTERS: Final = f"resource{BAR_INDEX}"
_RULES: Final = "inteco-abs doctor --rules prints the udev rules that give you access; install them and restart"
_SLOT: Final = "put the board into another slot, or check the settings of the computer's firmware"
_GONE: Final = "is the board still in its slot, and switched on?"
_WORDS: Final = {
    errno.EACCES: f"no permission: {_RULES}",
    errno.EPERM: "the kernel is locked down and forbids it: switch Secure Boot off in the computer's firmware",
    errno.ENODEV: f"the device is gone: {_GONE}",
    errno.EIO: f"the bus failed: {_GONE}",
}


class SysfsRegisters(Registers):
    """Registers of the RT-DAC4/PCI at `address`, as lspci writes it, or of the only board if it is empty.

    I/O ports use reads and writes of four bytes, memory uses a mapping. The board belongs to one program at a time; the
    kernel releases its lock when the program ends.

    `root` is /sys. Raises BoardError for no board or several, no permission, registers that are switched off or
    misplaced, or a board in use.
    """

    def __init__(self, address: str = "", root: Path = Path("/sys")) -> None:
        require_linux("a board on the PCI bus")
        folder = find_pci_board(address, root)
        _require_enabled(folder)
        in_memory = _in_memory(folder)
        self._fd = _open_locked(folder / _REGISTERS)
        self._words: memoryview | None = None
        if in_memory:
            try:
                self._words = _map(self._fd)
            except OSError as error:
                self.close()
                raise BoardError(f"{folder / _REGISTERS} cannot be mapped: {_describe(error)}") from error

    def read(self, offset: int) -> int:
        """Read the 32 bits at `offset`."""
        if self._words is not None:
            return int(self._words[offset // REGISTER_BYTES])
        try:
            data = os.pread(self._fd, REGISTER_BYTES, offset)
        except OSError as error:
            raise LinkError(f"register 0x{offset:02X} cannot be read: {_describe(error)}") from error
        if len(data) != REGISTER_BYTES:
            raise LinkError(f"register 0x{offset:02X} gave {len(data)} bytes, must be {REGISTER_BYTES}: {_GONE}")
        return int.from_bytes(data, "little")

    def write(self, offset: int, value: int) -> None:
        """Write the 32 bits `value` at `offset`."""
        if self._words is not None:
            self._words[offset // REGISTER_BYTES] = value
            return
        try:
            written = os.pwrite(self._fd, value.to_bytes(REGISTER_BYTES, "little"), offset)
        except OSError as error:
            raise LinkError(f"register 0x{offset:02X} cannot be written: {_describe(error)}") from error
        if written != REGISTER_BYTES:
            raise LinkError(f"register 0x{offset:02X} took {written} bytes, must be {REGISTER_BYTES}: {_GONE}")

    def close(self) -> None:
        """Close the board and release its lock."""
        words, self._words = self._words, None
        if words is not None:
            words.release()
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)


def find_pci_board(address: str, root: Path) -> Path:
    """Return the folder of the board at `address`, or of the only board; raises BoardError."""
    found = pci_boards(root)
    short = address.lower()
    wanted = [folder for folder in found if not short or folder.name in (short, f"0000:{short}")]
    if len(wanted) == 1:
        return wanted[0]
    there = ", ".join(folder.name for folder in found) or "none"
    if wanted:
        raise BoardError(f"{len(wanted)} RT-DAC4/PCI boards: name one, as in pci:{wanted[0].name}. Seen: {there}")
    at = f" at {address}" if address else ""
    raise BoardError(
        f"no RT-DAC4/PCI board ({VENDOR_ID:04x}:{DEVICE_ID:04x}){at}: is it in its slot? Seen: {there}; "
        f"lspci -D -d {VENDOR_ID:04x}: shows what the computer has"
    )


def pci_boards(root: Path = Path("/sys")) -> list[Path]:
    """Return the folders of all boards in this computer."""
    ids = f"0x{VENDOR_ID:04x}", f"0x{DEVICE_ID:04x}"
    folders = sorted((root / "bus/pci/devices").glob("*"))
    return [folder for folder in folders if (_text(folder / "vendor"), _text(folder / "device")) == ids]


def _text(file: Path) -> str:
    """Return the content of a small file; empty if it cannot be read."""
    try:
        return file.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""


def _require_enabled(folder: Path) -> None:
    """Raise BoardError if the board is off: no kernel driver enables it, and its registers read as all ones."""
    if _text(folder / "enable") == "0":
        raise BoardError(
            f"the board at {folder.name} is switched off: echo 1 | sudo tee {folder / 'enable'}, or install the udev "
            "rules of inteco-abs doctor --rules, which do so at every start"
        )


def _in_memory(folder: Path) -> bool:
    """Return whether the register range is memory, not I/O ports.

    Reads its line in `resource`: first address, last address, flags. Raises BoardError without a usable range.
    """
    lines = _text(folder / "resource").splitlines()
    try:
        first, last, flags = (int(word, 16) for word in lines[BAR_INDEX].split())
    except (IndexError, ValueError) as error:
        raise BoardError(f"{folder / 'resource'} has no line for BAR {BAR_INDEX}: {_SLOT}") from error
    if not flags & (_IO | _MEMORY):
        raise BoardError(f"the board at {folder.name} has no register range (BAR {BAR_INDEX} is empty): {_SLOT}")
    size = last - first + 1
    if size < BAR_BYTES:
        raise BoardError(
            f"the register range of the board at {folder.name} has {size} bytes, must be {BAR_BYTES}: is it this board?"
        )
    if flags & _MEMORY and first % mmap.PAGESIZE:
        raise BoardError(
            f"the register range of the board at {folder.name} begins within a page (0x{first:x}), where it cannot be "
            f"mapped: start the kernel with pci=resource_alignment={folder.name}"
        )
    return bool(flags & _MEMORY)


def _open_locked(file: Path) -> int:
    """Open and lock the registers; raises BoardError."""
    try:
        fd = os.open(file, os.O_RDWR | os.O_CLOEXEC)
    except FileNotFoundError as error:
        raise BoardError(f"no {file}: {_SLOT}") from error
    except OSError as error:
        raise BoardError(f"{file} cannot be opened: {_describe(error)}") from error
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(fd)
        raise BoardError(f"another program has the board ({file} is locked): one program at a time") from error
    except OSError as error:
        os.close(fd)
        raise BoardError(f"{file} cannot be locked: {_describe(error)}") from error
    return fd


def _map(fd: int) -> memoryview:
    """Map the registers as words of 32 bits."""
    # an item of this view is one access of 32 bits; a slice is not
    return memoryview(mmap.mmap(fd, BAR_BYTES)).cast("I")


def _describe(error: OSError) -> str:
    return _WORDS.get(error.errno or 0, error.strerror or str(error))
