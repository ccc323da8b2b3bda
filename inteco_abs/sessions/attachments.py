"""Extracts an attachment from a session. Its name comes from the file, so it is data, never a path."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from inteco_abs.errors import ConfigError, SessionError, near_match
from inteco_abs.sessions.files import write_file
from inteco_abs.sessions.reader import Session

_LONGEST_NAME: Final = 200
"""Bytes: the limit of file systems, less the suffix of an unfinished file."""


def attached(session: Session, name: str) -> bytes:
    """The content of the attachment `name`. Raises ConfigError if the session does not have it."""
    if name not in session.attachments:
        known = near_match(name, session.attachments) if session.attachments else "; it has none"
        raise ConfigError.of("NAME", f"{session.path} has no attachment {name!r}{known}")
    return session.attachments[name]


def extract(session: Session, name: str, out: Path) -> Path:
    """Write the attachment `name` to the new file `out`, or into the folder `out` under its own name.

    Raises ConfigError or SessionError if it cannot be written, or if its name leads out of the folder.
    """
    data = attached(session, name)
    path = out / _file_name(session, name) if out.is_dir() else out
    write_file(path, data)
    return path


def _file_name(session: Session, name: str) -> str:
    """`name`, if it is a plain file name. Raises SessionError for a path, a hidden file or control characters."""
    odd = not name.isprintable() or any(letter in name for letter in '/\\:*?"<>|') or name.startswith((".", "-", " "))
    if odd or not name or len(name.encode()) > _LONGEST_NAME:
        raise SessionError(f"{session.path}: the attachment {name!r} is not named as a file; name one: --out FILE")
    return name
