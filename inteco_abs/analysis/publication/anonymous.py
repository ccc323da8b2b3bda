"""A copy of a session without the names of computers and folders; its ticks stay, and so does their hash."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from inteco_abs.errors import SessionError
from inteco_abs.sessions import CONTROLLER_FILES, CONTROLLER_SOURCE, LogEntry, Session, card_of, write_copy

_NAME: Final = r"(?:[\w.@+~-]|(?<=\w)[ ](?=\w+[/\\]))+"
_SLASH: Final = r"(?:/|\\{1,2})"
"""A backslash may be written twice, as in TOML and JSON."""
_PATH: Final = re.compile(
    rf"(?<![\w/.~-])(?:file://)?(?:(?:~|[A-Za-z]:|\\{{2,4}}[\w.-]+)(?:{_SLASH}{_NAME})+|(?:{_SLASH}{_NAME}){{2,}}){_SLASH}?"
)
"""An absolute path, below a home folder, or on a share; no part of a URL, no fraction."""
_LEFT_OUT: Final = {"host": ("hostname", "kernel_build"), "software": ("argv",)}
_AS_THEY_ARE: Final = (CONTROLLER_SOURCE, CONTROLLER_FILES)
"""Attachments that decide, so that a copy keeps every byte."""
_LEAST_NAME: Final = 3
"""Letters of a computer's name from which on it is replaced in texts."""


def without_names(session: Session) -> Session:
    """Return `session` without its host, and with paths in its texts cut to their last name.

    Raises SessionError if its own controller names a folder or the host: a changed source would not be what decided.
    """
    clean = _cleaner(session)
    source = session.attachments.get(CONTROLLER_SOURCE, b"").decode("utf-8", "replace")
    if wrong := [number for number, line in enumerate(source.splitlines(), 1) if clean(line) != line]:
        problem = f"line {wrong[0]} of {CONTROLLER_SOURCE} in it names a folder or the computer"
        raise SessionError(f"{session.path}: {problem}; a copy cannot change it")
    metadata = {
        name: {key: clean(value) for key, value in facts.items() if key not in _LEFT_OUT.get(name, ())}
        for name, facts in session.metadata.items()
    }
    attachments = {
        name: data if name in _AS_THEY_ARE or _is_binary(data) else clean(data.decode()).encode()
        for name, data in session.attachments.items()
    }
    log = [LogEntry(unix_ns, level, clean(text)) for unix_ns, level, text in session.log]
    return replace(session, metadata=metadata, attachments=attachments, log=log)


def write_whole(session: Session, path: Path) -> None:
    """Write all of `session`, as it is in memory, to the new file `path`."""
    card = {**(card_of(session) or {}), "session": session.path.name}
    write_copy(
        session,
        path,
        session.blocks(),
        metadata=session.metadata,
        attachments=session.attachments,
        card=card,
        log=session.log,
        frames=True,
    )


def _cleaner(session: Session) -> Callable[[str], str]:
    """A function that takes absolute paths and the host's name out of a text."""
    host = session.metadata.get("host", {}).get("hostname", "")
    named = re.compile(rf"(?<![\w-]){re.escape(host)}(?![\w-])") if len(host) >= _LEAST_NAME else None

    def clean(text: str) -> str:
        without = _PATH.sub(lambda found: _last_name(found[0]), text)
        return named.sub("host", without) if named is not None else without

    return clean


def _last_name(path: str) -> str:
    return re.split(r"[/\\]", path.rstrip("/\\"))[-1] or path


def _is_binary(data: bytes) -> bool:
    try:
        data.decode()
    except UnicodeDecodeError:
        return True
    return False
