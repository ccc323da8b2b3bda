"""The processes of a real-time run, one module each."""

from typing import Final

ENTRY: Final = __name__
"""What `python -m` starts them by, with role and memory as arguments."""
