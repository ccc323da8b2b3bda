"""RT-DAC4/PCI with the ABS logic: registers on the PCI bus."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from inteco_abs.boards.families.pci.board import RtdacPci
from inteco_abs.boards.family import BoardFamily
from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.registers import LinkedRegisters, Registers
from inteco_abs.boards.transports.sysfs import SysfsRegisters
from inteco_abs.config import BoardConfig

__all__ = ["FAMILY", "RtdacPci"]


def _driver(carrier: Link | Registers, wiring: BoardConfig, now_ns: Callable[[], int], period_ns: int) -> RtdacPci:
    registers = LinkedRegisters(carrier) if isinstance(carrier, Link) else carrier
    return RtdacPci(registers, wiring, now_ns, period_ns)


FAMILY: Final = BoardFamily(
    name="pci",
    title="RT-DAC4/PCI",
    documentation="docs/boards.md",
    address_meaning="an RT-DAC4/PCI, by its PCI address if there are several",
    address=re.compile(r"([0-9a-f]{4}:)?([0-9a-f]{2}:[0-9a-f]{2}\.[0-7])?", re.IGNORECASE),
    address_hint="after pci: comes the address as lspci -D shows it, as in pci:0000:03:0a.0",
    profile="pci_abs_50f",
    mock_profile="sim_pci",
    transport=lambda place, _config: SysfsRegisters(place),
    driver=_driver,
    mock="inteco_abs.boards.families.pci.mock:MOCK",
    host="inteco_abs.boards.families.pci.host:HOST",
    reports_name=False,
    unused_wiring=frozenset({"frame_map", "pwm_pins", "pwm_functions"}),
    fast_readings=True,
    velocity="road_velocity",
    reading_caution="reading a board on the PCI bus selects channels in two registers, its only writes: do not read it "
    "while another program drives it",
)
