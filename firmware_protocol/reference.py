"""Writes PROTOCOL.md from the tables: `python -m firmware_protocol.reference [--check]`."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from firmware_protocol import open_board_reference, rtdac_pci, rtdac_usb, rtdac_usb2
from firmware_protocol.fields import FrameField, Layout, ValueKind
from firmware_protocol.markdown import table
from firmware_protocol.registers import Register, RegisterMap

PATH: Final = Path(__file__).with_name("PROTOCOL.md")

_USB2: Final = """\
# Protocol reference

Generated from the tables of this package by `python -m firmware_protocol.reference`; a check fails when it is stale.
Do not edit.

## RT-DAC/USB2

One frame is {size} bytes: 16-bit words, little-endian; `w20[0:15]` is bits 0 to 14 of word 20 and a `+` joins the
parts of a value, low part first. Bits that neither direction names are sent back as they were read; fields
that are only read are sent as zero.

* **READ**: OUT `{request}` on bulk endpoint 0x{out:02X}, then IN {size} bytes on 0x{into:02X}. Read words use all
  16 bits.
* **SEND**: OUT {size} bytes on bulk endpoint 0x{out:02X}, word 0 = 0x{send:04X}. No reply. Bit 15 of every data
  word is 0.
* Status: confirmed = read in the named source, inferred = deduced, unknown = no source.
* The logic in the FPGA defines the words, not the board. The programs for TRAS and rpend, the two rig logics whose
  driver is public, send w31 = 3, thermal protection on, in every frame; in the generic logic w31 is the width of PWM 3.
* Servo, TRAS and rpend have the same pin-out of CN1 (confirmed there, inferred for the ABS rig): PWM 0 has thermal
  input 18, PWM 19, brake 20, direction 21; PWM 1 has thermal input 22, PWM 23, brake 24, direction 25. Their programs
  set a brake pin while its width is 0. All three let timer 0 run free (mode 1, reset 0) at 20 MHz.
* Sources S1, S4, S5, S10: [docs/facts/sources.md](../docs/facts/sources.md#s1).

### Generic logic, 0x{logic:04X}
"""

_RIG_LOGICS: Final = {
    "servo": "Servo logic",
    "tras": "TRAS logic, the two-rotor rig's",
    "rpend": "rpend logic, the reaction pendulum's",
    "abs": "ABS logic: not published; the fields that servo, TRAS and rpend share",
}

_USB: Final = """\
## RT-DAC/USB, first generation

One frame is {size} bytes through an FTDI chip used as a FIFO. `b21[0:7]` is bits 0 to 6 of data byte 21, which is byte
21 of a READ frame and byte 22 of a SEND frame, behind the command. Bits that neither direction names are sent back as
they were read; fields that are only read are sent as zero.

* **Dummy**: OUT `{dummy}`, once after opening: leaves the mode in which the FPGA is programmed. No reply.
* **READ**: OUT `{request}`, then IN {size} bytes. They use all 8 bits.
* **SEND**: OUT {size} bytes, the first = 0x{send:02X}. No reply. Bit 7 of every data byte is 0.
* **SEND and READ**: 0x{both:02X} is defined, but no known program uses it (inferred, not used here).
* On opening, the vendor's library resets the chip, sets its latency timer to {latency} ms and enables the event
  character 0x{event:02X}.
* Logic version and name are in the same bytes in every logic: they select the table.
* Source S2: [docs/facts/sources.md](../docs/facts/sources.md#s2). Inferred here means that the place is
  confirmed, but not all of the meaning.
"""

_PCI: Final = """\
## RT-DAC4/PCI, ABS logic 0x{logic:04X}

PCI device {vendor:04x}:{device:04x}, {size} bytes of I/O at base address register {bar}: {count} registers of 32 bits,
always accessed whole. `0x04[12:16]` is bits 12 to 15 of the register at byte offset 0x04.

* **Index, then data**: a register with an index exists once per channel. Write the channel to the index register,
  then access the data register, without another access in between: the pair is not atomic.
* **Alarm flags are advisory.** The sources disagree which of bits 0 and 2 is the temperature's and which the speed's
  (K1), and whether 1 means tripped (K2; [contradictions](../docs/facts/boards.md#contradictions)). Do not
  use them.
* **Thresholds are only read.** Whether they can be written is unknown; no source writes them.
* At {collisions} the ABS logic has thresholds where the generic map has its A/D converter: a program
  for one logic must not write to the other. The version is checked before anything is written.
* Source S3: [docs/facts/sources.md](../docs/facts/sources.md#s3).
"""

_PCI_GENERIC: Final = """\
### Generic registers

Also named in the vendor's driver, without evidence that the ABS logic has them. For reference, not for access.
"""


def where(layout: Layout | None, letter: str = "w") -> str:
    """Return the short notation of a layout; `-` if the direction does not carry the field."""
    if layout is None:
        return "-"
    return " + ".join(f"{letter}{part.word}[{part.low}:{part.low + part.width}]" for part in layout)


def _limits(field: FrameField) -> str:
    layout = field.read or field.send or ()
    if field.kind not in {ValueKind.UNSIGNED, ValueKind.SIGNED}:
        return str(field.kind.value)
    low, high = field.range(layout)
    limits = f"{low}..{high}"
    if field.read and field.send and field.range(field.read) != field.range(field.send):
        limits += f" (send: ..{field.range(field.send)[1]})"
    return limits


def _fields(fields: Iterable[FrameField], letter: str) -> str:
    columns = ("field", "READ", "SEND", "range", "unit", "meaning", "status", "source")
    return table(
        columns,
        (
            (
                f"`{field.name}`",
                where(field.read, letter),
                where(field.send, letter),
                _limits(field),
                field.unit,
                field.meaning,
                field.status.value,
                field.source,
            )
            for field in fields
        ),
    )


def _register(register: Register) -> tuple[str, ...]:
    conversion = register.conversion
    return (
        f"`{register.name}`",
        f"0x{register.offset:02X}[{register.low}:{register.low + register.width}]",
        register.access.value,
        f"`{register.index.name}`" if register.index else "-",
        "{}..{}".format(*register.range),
        register.unit,
        f"{conversion.unit} = {conversion.formula}" if conversion else "-",
        register.meaning,
        register.status.value,
        register.source,
    )


def _registers(registers: RegisterMap) -> str:
    columns = ("register", "bits", "access", "index", "range", "unit", "conversion", "meaning", "status", "source")
    ordered = sorted(registers.registers.values(), key=lambda register: (register.offset, register.low))
    return table(columns, map(_register, ordered))


def _usb2_section() -> str:
    head = _USB2.format(
        logic=rtdac_usb2.LOGIC_VERSION,
        size=rtdac_usb2.FRAME_BYTES,
        request=rtdac_usb2.READ_REQUEST.hex(" ").upper(),
        send=rtdac_usb2.SEND_COMMAND,
        out=rtdac_usb2.ENDPOINT_OUT,
        into=rtdac_usb2.ENDPOINT_IN,
    )
    rigs = (
        f"### {_RIG_LOGICS[name]}\n\n{_fields(logic.fields, 'w')}"
        for name, logic in rtdac_usb2.LOGICS.items()
        if name in _RIG_LOGICS
    )
    return "\n".join([head, _fields(rtdac_usb2.FIELDS, "w"), *rigs])


def _usb_section() -> str:
    head = _USB.format(
        size=rtdac_usb.FRAME_BYTES,
        dummy=rtdac_usb.DUMMY.hex().upper(),
        request=rtdac_usb.READ_REQUEST.hex().upper(),
        send=rtdac_usb.SEND_COMMAND,
        both=rtdac_usb.SEND_AND_READ_COMMAND,
        latency=rtdac_usb.LATENCY_TIMER_MS,
        event=rtdac_usb.EVENT_CHARACTER,
    )
    logics = (
        f"### Logic 0x{version:04X}\n\n{_fields(logic.fields, 'b')}" for version, logic in rtdac_usb.LOGICS.items()
    )
    return "\n".join([head, *logics])


def _pci_section() -> str:
    head = _PCI.format(
        logic=rtdac_pci.LOGIC_VERSION,
        vendor=rtdac_pci.VENDOR_ID,
        device=rtdac_pci.DEVICE_ID,
        size=rtdac_pci.BAR_BYTES,
        bar=rtdac_pci.BAR_INDEX,
        count=rtdac_pci.REGISTER_COUNT,
        collisions=", ".join(f"0x{offset:02X}" for offset in rtdac_pci.COLLISIONS),
    )
    return f"{head}\n{_registers(rtdac_pci.ABS)}\n{_PCI_GENERIC}\n{_registers(rtdac_pci.GENERIC)}"


def render() -> str:
    """Return the whole document as Markdown."""
    return f"{_usb2_section()}\n{_usb_section()}\n{_pci_section()}\n{open_board_reference.section()}"


def main(arguments: list[str]) -> int:
    """Write the document; with --check, exit with 1 if it is out of date."""
    if arguments not in ([], ["--check"]):
        sys.stderr.write("usage: python -m firmware_protocol.reference [--check]\n")
        return 2
    if not arguments:
        PATH.write_text(render(), encoding="utf-8")
        return 0
    if PATH.is_file() and PATH.read_text(encoding="utf-8") == render():
        return 0
    sys.stderr.write(f"{PATH.name} is stale: run python -m firmware_protocol.reference\n")
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
