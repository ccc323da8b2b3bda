"""Lists serial ports that may be an RT-DAC/USB, and checks their latency, without opening one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.host import (
    INSTALL_FTDI_RULES,
    UDEV_FILE,
    Computer,
    FoundBoard,
    HostFamily,
    Judgement,
    amber,
    green,
    last_part,
    usb_description,
    usb_strings,
)

_PORTS: Final = "sys/bus/usb-serial/devices/*"
_LEAST_LATENCY_MS: Final = 1


def _found(computer: Computer, _: RigConfig, path: str) -> list[FoundBoard]:
    """List serial ports behind USB chips; the first RT-DAC/USB looks like any of them."""
    found = []
    for port in computer.matching(_PORTS):
        device = str((computer.root / port).resolve().parent.parent)  # port -> interface -> device
        description, strings = usb_description(computer, device), usb_strings(computer, device)
        found.append(FoundBoard(f"usb:/dev/{last_part(port)}", description, strings))
    if not path:
        return found
    named = Path(path).resolve()
    if not named.is_char_device():
        return []
    chosen = [one for one in found if Path(one.address.removeprefix("usb:")) == named]
    return chosen or [FoundBoard(f"usb:{path}", "a serial port that is not behind a USB chip")]


def _ftdi_ports(computer: Computer) -> list[str]:
    """List serial ports of FTDI chips."""
    ports = computer.matching("sys/bus/usb-serial/devices/ttyUSB*")
    return [port for port in ports if computer.text_or(f"{port}/latency_timer", "")]


def _ftdi_latency(computer: Computer, folder: str) -> Judgement:
    file = f"{folder}/latency_timer"
    latency_ms = int(computer.text(file))
    if latency_ms <= _LEAST_LATENCY_MS:
        return green(f"{last_part(folder)} {latency_ms} ms")
    serial = computer.text_or(f"{folder}/../../serial", "")
    for_good = f"; for good: {INSTALL_FTDI_RULES.format(serial)}" if serial else ""
    return amber(
        f"{last_part(folder)} {latency_ms} ms, which each answer waits",
        f"if it is the board, echo {_LEAST_LATENCY_MS} | sudo tee /{file}{for_good}",
    )


def _modem_manager(computer: Computer, folder: str) -> Judgement:
    if not any(computer.text_or(file, "") == "ModemManager" for file in computer.matching("proc/[0-9]*/comm")):
        return green("not running")
    serial = computer.text_or(f"{folder}/../../serial", "")
    if serial and f'"{serial}"' in computer.text_or(UDEV_FILE.lstrip("/"), ""):
        return green(f"leaves {last_part(folder)} alone")
    return amber(
        f"it sends commands for modems to {last_part(folder)} when that is plugged in",
        f"if it is the board: {INSTALL_FTDI_RULES.format(serial or 'NUMBER')}",
    )


HOST: Final = HostFamily(
    found=_found, folders=_ftdi_ports, checks={"FTDI latency": _ftdi_latency, "ModemManager": _modem_manager}
)
