"""Takes an attachment out of a session. Its name comes from the file, so it is data, never a path."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from inteco_abs.errors import ConfigError, SessionError, describe_disk, near_match
from inteco_abs.sessions.files import atomic_write, check_output
from inteco_abs.sessions.reader import Session

_LONGEST_NAME: Final = 200
"""Bytes: what file systems take, with what is added while the file is being written."""


def attached(session: Session, name: str) -> bytes:
    """The attachment `name`; raises ConfigError if the session has none of that name."""
    if name not in session.attachments:
        known = near_match(name, session.attachments) if session.attachments else "; it has none"
        raise ConfigError.of("NAME", f"{session.path} has no attachment {name!r}{known}")
    return session.attachments[name]


def extract(session: Session, name: str, out: Path) -> Path:
    """Write the attachment `name` to the new file `out`, or into the folder `out` under its own name.

    Raises ConfigError or SessionError where that cannot be, above all for a name that leaves the folder.
    """
    data = attached(session, name)
    path = out / _plain(session, name) if out.is_dir() else out
    check_output(path)
    with atomic_write(path) as part:
        try:
            with part.open("xb") as file:
                file.write(data)
        except OSError as error:
            raise SessionError(f"{path} cannot be written: {describe_disk(error)}") from error
    return path


def _plain(session: Session, name: str) -> str:
    """`name`, if it is one of a file in a folder and nothing else."""
    odd = not name.isprintable() or any(letter in name for letter in '/\\:*?"<>|') or name.startswith((".", "-", " "))
    if odd or not name or len(name.encode()) > _LONGEST_NAME:
        raise SessionError(f"{session.path}: the attachment {name!r} is not named as a file; name one: --out FILE")
    return name
