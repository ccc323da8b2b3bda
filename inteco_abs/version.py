"""Version of the package, and its source: no layer imports the top package for them."""

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

__version__: Final = version("inteco-abs")
SOURCE_FOLDER: Final = Path(__file__).parent
"""Where the package lies."""


@cache
def source_sha256() -> str:
    """SHA-256 of the package's sources, the same in a checkout and an installation; the version says less.

    Takes some 20 ms the first time.
    """
    home = SOURCE_FOLDER.parent
    found = hashlib.sha256()
    files = [file for name in ("firmware_protocol", SOURCE_FOLDER.name) for file in (home / name).rglob("*.py")]
    for place, file in sorted((file.relative_to(home).as_posix(), file) for file in files):
        content = file.read_bytes()
        found.update(f"{place}\0{len(content)}\0".encode() + content)
    return found.hexdigest()
