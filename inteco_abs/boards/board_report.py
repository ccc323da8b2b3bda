"""A board report without its frames: descriptors, timing, the computer, and the profile so far.

It is anonymous: no user, computer name, path or serial number.
"""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from inteco_abs.errors import CaptureError

_LONGEST: Final = 200
Text = Annotated[str, Field(max_length=_LONGEST)]
Hex = Annotated[str, Field(pattern=r"^([0-9a-f]{2})*$", max_length=8192)]
"""Bytes as pairs of hex digits."""
Count = Annotated[int, Field(ge=0, le=1_000_000_000)]
Values = dict[Text, bool | int | float | Text | list[int | Text]]


class _Part(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class Bus(_Part):
    """The device as the kernel lists it."""

    descriptors: Hex = ""
    """USB: the device descriptor and all of its configuration's; PCI: the configuration space's first 64 bytes."""
    manufacturer: Text = ""
    product: Text = ""
    serial_form: Text = ""
    """The serial number with every digit as 9 and every letter as x: its length and form."""
    speed: Text = ""
    """Speed of the bus, Mbit/s."""


class BoardHeader(_Part):
    """The board's header, and the dates of its bridge's firmware if known."""

    logic_version: Annotated[int, Field(ge=0, le=0xFFFF)]
    application_name: Text = ""
    synthesis_date: Text = ""
    firmware_compiled: Text = ""
    firmware_released: Text = ""


class Reads(_Part):
    """Timing of a thousand READ requests in a row."""

    count: Count
    failed: Count
    histogram_us: dict[Annotated[str, Field(pattern=r"^[0-9]{1,4}$")], Count] = {}
    """Number of readings by their time in whole us; the last bin has all from 2047 us on."""


class BoardReport(_Part):
    """The report; its images are the capture's records."""

    kind: Text
    """Board family."""
    identity: BoardHeader
    bus: Bus = Bus()
    reads: Reads | None = None
    steps: dict[Text, Text] = {}
    """State of each step of the commissioning."""
    images: list[Text] = []
    """Meaning of each image, in the order of the records."""
    profile: dict[Text, Values] = {}
    """Numbers of the draft, and its texts that come from the program or the board."""
    computer: dict[Text, Text] = {}
    """Kernel, CPU model, operating system, versions."""


def parse_report(table: object, place: str) -> BoardReport:
    """Return the report in a capture's first line; raises CaptureError with path and value of a mistake."""
    try:
        return BoardReport.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join(map(str, ("report", *first["loc"])))
        raise CaptureError(f"{place}: {path} = {str(first['input'])[:40]!r}: {first['msg']}") from error
