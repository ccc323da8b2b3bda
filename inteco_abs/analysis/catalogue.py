"""A folder of sessions as rows with their facts and metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

from inteco_abs.errors import SessionError, near_file
from inteco_abs.sessions import (
    DamagedError,
    Metadata,
    card_of,
    newer,
    read_metadata,
    read_session,
    stored_card,
)

SUFFIX: Final = ".mcap"
INCOMPLETE: Final = "incomplete"
BROKEN: Final = "broken"
COLUMNS: Final = (
    "session",
    "started_utc",
    "outcome",
    "controller",
    "estimator",
    "board",
    "rig",
    "ticks",
    "slip_rms_true",
    "slip_rms_estimated",
    "band_entry_s",
    "stop_time_s",
    "overruns",
    "lost_ticks",
    "injected",
    "problem",
)
"""Keys of a row; a value that the session lacks is None."""
_OF_THE_CARD: Final = COLUMNS[7:-2]

CatalogueRow = dict[str, Any]


def session_files(folder: Path, *, nested: bool = False) -> list[Path]:
    """Files in `folder`, and below it if `nested`, with the suffix of sessions. Raises SessionError."""
    try:
        found = folder.rglob(f"*{SUFFIX}") if nested else folder.iterdir()
        return sorted(path for path in found if path.suffix == SUFFIX and not path.is_dir())
    except OSError as error:
        hint = f"; it is a file: inteco-abs info {folder}" if folder.is_file() else near_file(folder)
        hint = hint or "; name a folder with sessions"
        raise SessionError(f"{folder}: cannot be listed: {error.strerror}{hint}") from error


def session_row(path: Path) -> CatalogueRow:
    """Row of one file; a damaged file has a `problem` and raises nothing."""
    try:
        metadata = read_metadata(path)
    except DamagedError:
        return _row_of_ticks(path)
    except SessionError as error:
        return _broken(path, error)
    card = stored_card(metadata)
    if card is None or "session" not in metadata:
        return _broken(path, SessionError("is an MCAP file, but not a session of this program"))
    return _row(path, metadata, card)


def sort_rows(rows: Iterable[CatalogueRow], key: str, *, reverse: bool = False) -> list[CatalogueRow]:
    """Rows by one of `COLUMNS`; those without a value are last in both directions."""
    rows = list(rows)
    known = [row for row in rows if row[key] is not None]
    value: Callable[[CatalogueRow], Any] = itemgetter(key)
    return sorted(known, key=value, reverse=reverse) + [row for row in rows if row[key] is None]


def _row_of_ticks(path: Path) -> CatalogueRow:
    """Row of a file without a usable index: the whole file is read."""
    try:
        session = read_session(path)
    except SessionError as error:
        return _broken(path, error)
    row = _row(path, session.metadata, card_of(session) or {})
    row["ticks"] = session.tick_count
    row["outcome"] = row["outcome"] or INCOMPLETE
    row["problem"] = session.incomplete or session.unsupported or "its index is damaged"
    return row


def _row(path: Path, metadata: Metadata, card: Mapping[str, Any]) -> CatalogueRow:
    session, controller, rig = (metadata.get(name, {}) for name in ("session", "controller", "rig"))
    return {
        "session": str(path),
        "started_utc": session.get("started_utc"),
        "outcome": session.get("outcome"),
        "controller": controller.get("name"),
        "estimator": controller.get("estimator"),
        "board": rig.get("board"),
        "rig": rig.get("drawn"),
        **{name: _number(card.get(name)) for name in _OF_THE_CARD},
        "injected": ", ".join(metadata.get("injected", {})) or None,
        "problem": newer(metadata) or None,
    }


def _number(value: object) -> int | float | None:
    return value if isinstance(value, int | float) else None


def _broken(path: Path, error: SessionError) -> CatalogueRow:
    problem = str(error).removeprefix(f"{path}: ")
    return {**dict.fromkeys(COLUMNS), "session": str(path), "outcome": BROKEN, "problem": problem}
