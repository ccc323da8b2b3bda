"""The figures that the checks keep in tests/RESULTS.md, a section for each tool that writes them."""

import re
from pathlib import Path

FILE = Path(__file__).parent / "RESULTS.md"
HEAD = """# What the checks have found

Each section is written by the tool that it names, with --write. Everything here is of the mock board.
"""


def keep(title: str, text: str) -> None:
    """Put a section in, or in the place of the one before."""
    before = FILE.read_text(encoding="utf-8") if FILE.exists() else HEAD
    head, *sections = re.split(r"^## ", before, flags=re.MULTILINE)
    kept = {name: body for name, _, body in (section.partition("\n") for section in sections)}
    kept[title] = text
    parts = (f"## {name}\n\n{body.strip()}\n" for name, body in kept.items())
    FILE.write_text("\n".join([f"{head.strip()}\n", *parts]), encoding="utf-8")
