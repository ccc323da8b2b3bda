"""Writes PROTOCOL.md out of the tables: `python -m firmware_protocol.reference [--check]`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

from firmware_protocol import rtdac_usb2
from firmware_protocol.fields import Field, Layout

PATH: Final = Path(__file__).with_name("PROTOCOL.md")

_INTRODUCTION: Final = """\
# Protocol reference

Generated from the tables of this package by `python -m firmware_protocol.reference`; a check fails when it is stale.
Do not edit.

## RT-DAC/USB2, logic 0x{logic:04X}

One frame is {size} bytes: 16-bit words, little-endian; `w20[0:15]` is bits 0 to 14 of word 20 and a `+` joins the
parts of a value, low part first. Words that no field names are sent as zero.

* **READ**: OUT `{request}` on bulk endpoint 0x{out:02X}, then IN {size} bytes on 0x{into:02X}. Read words use all
  16 bits.
* **SEND**: OUT {size} bytes on bulk endpoint 0x{out:02X}, word 0 = 0x{send:04X}. No reply. Bit 15 of every data
  word is 0.
* Status: confirmed = read in the named source, inferred = deduced, unknown = no source.
* Source S1: the vendor's C# sample for this board, as adapted in is-centre/rtdacusb2-bridge-app at 49a5c5d (facts
  only; the code is the vendor's).
"""


def where(layout: Layout | None) -> str:
    """Short notation of a layout, `-` where the direction does not carry the field."""
    if layout is None:
        return "-"
    return " + ".join(f"w{part.word}[{part.low}:{part.low + part.width}]" for part in layout)


def _row(field: Field) -> str:
    layout = field.read or field.send or ()
    low, high = field.range(layout)
    limits = f"{low}..{high}" if field.kind.value in {"unsigned", "two's complement"} else field.kind.value
    if field.read and field.send and field.range(field.read) != field.range(field.send):
        limits += f" (send: ..{field.range(field.send)[1]})"
    cells = (
        f"`{field.name}`",
        where(field.read),
        where(field.send),
        limits,
        field.unit,
        field.meaning,
        field.status.value,
        field.source,
    )
    return "| " + " | ".join(cells) + " |"


def render() -> str:
    """The whole document."""
    head = _INTRODUCTION.format(
        logic=rtdac_usb2.LOGIC_VERSION,
        size=rtdac_usb2.FRAME_BYTES,
        request=rtdac_usb2.READ_REQUEST.hex(" ").upper(),
        send=rtdac_usb2.SEND_COMMAND,
        out=rtdac_usb2.ENDPOINT_OUT,
        into=rtdac_usb2.ENDPOINT_IN,
    )
    columns = ("field", "READ", "SEND", "range", "unit", "meaning", "status", "source")
    table = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    return head + "\n" + "\n".join([*table, *map(_row, rtdac_usb2.FIELDS)]) + "\n"


def main(arguments: list[str]) -> int:
    """Write the document, or with --check say whether it is up to date (exit 1 when stale)."""
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
