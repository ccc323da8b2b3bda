"""The processes of a real-time run, one module each."""

from typing import Final

ENTRY: Final = __name__
"""Module for `python -m`, with role and memory as arguments."""
