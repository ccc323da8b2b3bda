"""Serial ports that may be an RT-DAC/USB of the first generation, and the latency timer of the chip behind one."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Final

from serial.tools import list_ports

from firmware_protocol.rtdac_usb import EVENT_CHARACTER, LATENCY_TIMER_MS
from inteco_abs.errors import BoardError

_FTDI: Final = 0x0403
_EVENT_ENABLED: Final = 0x100
"""Ninth bit of `ftdi_sio`'s attribute event_char."""
_PORTS: Final = Path("/sys/bus/usb-serial/devices")


def only_port() -> str:
    """Return the path of the only serial port of an FTDI chip; raises BoardError unless there is exactly one."""
    seen = ftdi_ports()
    if len(seen) == 1:
        return next(iter(seen))
    if seen:
        raise BoardError(
            f"{len(seen)} ports may be the board: name one, as in usb:{next(iter(seen))}. {describe_ports(seen)}"
        )
    raise BoardError(
        f"no RT-DAC/USB: {describe_ports(seen)}. Is it plugged in, and the kernel's module ftdi_sio loaded?"
    )


def ftdi_ports() -> dict[str, str]:
    """Return the serial ports of FTDI chips: path and description."""
    found = (port for port in list_ports.comports() if port.vid == _FTDI)
    return {port.device: f"{port.device} ({port.description}, serial number {port.serial_number})" for port in found}


def describe_ports(seen: dict[str, str]) -> str:
    """Describe `ftdi_ports` for a message."""
    return f"seen: {'; '.join(seen.values())}" if seen else f"no serial port has vendor id {_FTDI:04x}"


def set_latency_timer(path: str, ports: Path = _PORTS) -> str:
    """Set the latency timer of an FTDI chip's port to 1 ms and read it back; enable the vendor's event character.

    Returns an empty text on success or without such a timer; else what is wrong and what to do.
    """
    folder = ports / Path(path).resolve().name
    file = folder / "latency_timer"
    if not file.exists():
        return ""
    with suppress(OSError):  # without permission, the udev rule has set both
        file.write_text(f"{LATENCY_TIMER_MS}\n", encoding="ascii")
    if (event := folder / "event_char").exists():  # not every chip has one; write-only
        with suppress(OSError):
            event.write_text(f"{_EVENT_ENABLED | EVENT_CHARACTER}\n", encoding="ascii")
    try:
        latency_ms = int(file.read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        return f"{file} cannot be read: {error}"
    if latency_ms <= LATENCY_TIMER_MS:
        return ""
    return (
        f"each answer of {path} waits {latency_ms} ms in its chip, must be {LATENCY_TIMER_MS} ms, and this user may "
        "not change that: inteco-abs doctor --rules --ftdi-serial NUMBER prints the udev rule that does; or "
        f"echo {LATENCY_TIMER_MS} | sudo tee {file}"
    )
