"""Frames between two processes on one computer, over a local socket that keeps message boundaries.

The board's process sends the greeting to the host that it accepts, and closes all other connections.
"""

from typing import Final

GREETING: Final = b"board"
