"""What is on the wire between a host and an RT-DAC board, as tables. Standard library only."""

from firmware_protocol.fields import Field, FrameTable, Kind, ProtocolError, Status, TableError

__all__ = ["Field", "FrameTable", "Kind", "ProtocolError", "Status", "TableError"]
