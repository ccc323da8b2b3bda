"""A controller's source and the files beside it as one value, which travels to other processes and into the session."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import PurePath
from typing import Final, NamedTuple

_ZIP: Final = b"PK\x03\x04"
MOST_BYTES: Final = 10_000_000
"""Size of all files beside a controller, at most."""


class SourceFiles(NamedTuple):
    """A source and the files that it loads, by their paths below its folder."""

    source: bytes
    files: Mapping[str, bytes]

    def packed(self, name: str) -> bytes:
        """The source itself or, with files, a zip archive that begins with the source under this name."""
        if not self.files:
            return self.source
        return zipped({name: self.source, **dict(sorted(self.files.items()))})


def zipped(files: Mapping[str, bytes]) -> bytes:
    """Zip archive of files by their names, in their order; the same bytes every time."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, content in files.items():
            archive.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)  # without its time
    return buffer.getvalue()


def unpacked(data: bytes) -> SourceFiles:
    """What `packed` made `data` of.

    Raises ValueError for a damaged archive, one that is too large unpacked, or one with files outside of its folder.
    """
    if not data.startswith(_ZIP):
        return SourceFiles(data, {})
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            parts = archive.infolist()
            if sum(part.file_size for part in parts) > 2 * MOST_BYTES:
                raise ValueError(f"has more than {2 * MOST_BYTES / 1e6:.0f} MB unpacked")
            if not parts or any(part.compress_type != zipfile.ZIP_DEFLATED for part in parts):
                raise ValueError("damaged archive: not as a session keeps it")  # other methods may need much memory
            first, *others = parts
            for part in others:
                _require_below(part.filename)
            return SourceFiles(archive.read(first), {part.filename: archive.read(part) for part in others})
    except (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError) as error:  # RuntimeError: encrypted, or new
        raise ValueError(f"damaged archive: {error}") from error


def _require_below(name: str) -> None:
    """Raise ValueError for a path that is not below the folder of its source."""
    path = PurePath(name)
    if path.anchor or ".." in path.parts:
        raise ValueError(f"{name!r} leads out of their folder")
