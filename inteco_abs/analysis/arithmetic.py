"""The arithmetic that a session was recorded with, for what repeats its decisions."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from inteco_abs import elementary
from inteco_abs.errors import SessionError
from inteco_abs.sessions import Session

_ONE_ARITHMETIC: Final = threading.RLock()


def recorded_with(session: Session) -> str:
    """Name of the arithmetic that the session was recorded with."""
    name: str = session.metadata.get("software", {}).get("arithmetic", elementary.PORTABLE)
    return name


@contextmanager
def recorded_arithmetic(session: Session) -> Iterator[None]:
    """Compute with the arithmetic that the session was recorded with; other threads' replays wait meanwhile.

    Make the pipeline in it, too. Raises SessionError for an arithmetic that is not known here.
    """
    name = recorded_with(session)
    if name not in elementary.ARITHMETICS:
        known = ", ".join(elementary.ARITHMETICS)
        raise SessionError(f"{session.path}: software.arithmetic is {name!r}: must be one of {known}")
    with _ONE_ARITHMETIC, elementary.arithmetic(name):
        yield
