"""The protocols between a host and an RT-DAC board, as tables. Standard library only."""

from firmware_protocol.fields import (
    FrameField,
    FrameTable,
    Logic,
    Place,
    ProtocolError,
    Status,
    TableError,
    ValueKind,
    signed32,
)
from firmware_protocol.registers import Access, Conversion, Register, RegisterMap, Write

__all__ = [
    "Access",
    "Conversion",
    "FrameField",
    "FrameTable",
    "Logic",
    "Place",
    "ProtocolError",
    "Register",
    "RegisterMap",
    "Status",
    "TableError",
    "ValueKind",
    "Write",
    "signed32",
]
