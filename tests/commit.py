"""What the checks draw by the commit: another part of what takes long with each, and the same in each run of it."""

import subprocess
from pathlib import Path


def drawn_by_the_commit(count: int) -> int:
    """A number below `count`; 0 outside of a repository."""
    head = subprocess.run(
        ["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True, check=False
    ).stdout.strip()
    return int(head or "0", 16) % count
