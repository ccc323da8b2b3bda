"""Lists serial ports of USB devices that may be an open board, without opening one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.host import (
    Computer,
    FoundBoard,
    HostFamily,
    Judgement,
    last_part,
    serial_group,
    usb_description,
    usb_strings,
    writable,
)

_PORTS: Final = "sys/class/tty/ttyACM*"


def _ports(computer: Computer) -> list[str]:
    return computer.matching(_PORTS)


def _found(computer: Computer, _: RigConfig, path: str) -> list[FoundBoard]:
    """List the ports of USB devices with a serial port of their own; HELLO tells which is the board, on opening."""
    found = []
    for port in _ports(computer):
        device = str((computer.root / port / "device").resolve().parent)  # interface -> device
        description, strings = usb_description(computer, device), usb_strings(computer, device)
        found.append(FoundBoard(f"open:/dev/{last_part(port)}", description, strings))
    if not path:
        return found
    named = Path(path).resolve()
    if not named.is_char_device():
        return []
    chosen = [one for one in found if Path(one.address.removeprefix("open:")) == named]
    return chosen or [FoundBoard(f"open:{path}", "a serial port that is not of a USB device")]


def _access(computer: Computer, folder: str) -> Judgement:
    denied = f"sudo usermod -aG {serial_group(computer)} $USER, then log in again"
    return writable(computer, f"dev/{last_part(folder)}", denied=denied)


HOST: Final = HostFamily(found=_found, folders=_ports, checks={"serial port": _access})
