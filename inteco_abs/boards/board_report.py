"""What a report says of a board besides its frames: descriptors, timing, the computer, the profile as far as it came.

It names nobody: no user, no computer, no path, no serial number.
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
    """The serial number with every digit as 9 and every other letter as x: whether it is decimal, and how long."""
    speed: Text = ""
    """Of the bus, in Mbit/s."""


class BoardHeader(_Part):
    """The board's header, and the dates of its bridge's firmware where there are any."""

    logic_version: Annotated[int, Field(ge=0, le=0xFFFF)]
    application_name: Text = ""
    synthesis_date: Text = ""
    firmware_compiled: Text = ""
    firmware_released: Text = ""


class Reads(_Part):
    """A thousand READ requests, one after the other."""

    count: Count
    failed: Count
    histogram_us: dict[Annotated[str, Field(pattern=r"^[0-9]{1,4}$")], Count] = {}
    """Number of readings by their time in whole microseconds; the last bin has all from 2047 us on."""


class BoardReport(_Part):
    """Everything but the images, which are the capture's records."""

    kind: Text
    """Board family."""
    identity: BoardHeader
    bus: Bus = Bus()
    reads: Reads | None = None
    steps: dict[Text, Text] = {}
    """What has become of each step of the commissioning."""
    images: list[Text] = []
    """What each image is, in the order of the records."""
    profile: dict[Text, Values] = {}
    """Numbers of the draft, and those of its texts that are words of the program or of the board."""
    computer: dict[Text, Text] = {}
    """Kernel, CPU model, operating system, versions."""


def parse_report(table: object, place: str) -> BoardReport:
    """The report in a capture's first line; raises CaptureError saying what is wrong with which value."""
    try:
        return BoardReport.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join(map(str, ("report", *first["loc"])))
        raise CaptureError(f"{place}: {path} = {str(first['input'])[:40]!r}: {first['msg']}") from error
