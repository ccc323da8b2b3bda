"""The configuration that a session was run with, as the session holds it."""

from __future__ import annotations

from typing import Final

from inteco_abs.config import Check, RigConfig, parse_config
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.sessions.reader import Session

CONFIG_NAME: Final = "config.toml"
"""Name of the attachment."""
RECOVERED: Final = "recovered"
"""Outcome of a session that was made of what is whole in a damaged file."""


def session_config(session: Session, checks: tuple[Check, ...]) -> RigConfig:
    """The effective configuration that the session was run with; raises SessionError if it is not usable."""
    stored = session.attachments.get(CONFIG_NAME)
    if stored is None:
        raise SessionError(f"{session.path}: holds no {CONFIG_NAME}, so there is nothing to replay it with")
    try:
        return parse_config(stored.decode("utf-8"), checks)
    except (ConfigError, UnicodeDecodeError) as error:
        raise SessionError(f"{session.path}: its {CONFIG_NAME} cannot be used here: {error}") from error
