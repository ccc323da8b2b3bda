"""How frames travel between two processes on one computer: a local socket that keeps message boundaries.

The board's process sends the greeting to the one host that has it, and hangs up on all others without a word.
"""

from typing import Final

GREETING: Final = b"board"
