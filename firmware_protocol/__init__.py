"""What is on the wire between a host and an RT-DAC board, as tables. Standard library only."""

from firmware_protocol.fields import Field, FrameTable, Kind, Place, ProtocolError, Status, TableError, signed32
from firmware_protocol.registers import Access, Conversion, Register, RegisterMap, Write

__all__ = [
    "Access",
    "Conversion",
    "Field",
    "FrameTable",
    "Kind",
    "Place",
    "ProtocolError",
    "Register",
    "RegisterMap",
    "Status",
    "TableError",
    "Write",
    "signed32",
]
