"""A folder of sessions as rows with their facts and metrics."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

from inteco_abs.analysis.conditions import parse_condition
from inteco_abs.analysis.gains import gains_in
from inteco_abs.analysis.index import default_index, indexed
from inteco_abs.errors import ConfigError, SessionError, near_file, near_match
from inteco_abs.quantities import finite
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
"""Keys that every row has; a value that the session lacks is None."""
_MOST_DIGITS: Final = 16
"""Of a whole number that a double holds, too."""
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
    """Row of one file: `COLUMNS`, then all else that is known of it by name; a damaged file has a `problem`.

    Names are those of the result card, gains, description, and of the configuration's rig and seed. Raises nothing.
    """
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


def session_rows(
    folder: Path, *, nested: bool = False, where: str = "", index: Path | None = None
) -> list[CatalogueRow]:
    """Rows of the files in `folder` that fulfil the condition `where`, by an `index` of files that have not changed.

    Raises ConfigError for a wrong condition, SessionError for a folder that cannot be read.
    """
    condition = parse_condition(where) if where else None
    files = session_files(folder, nested=nested)
    rows = indexed(files, session_row, condition, index or default_index())
    return [{**row, "session": str(files[at])} for at, row in rows]


def sort_rows(rows: Iterable[CatalogueRow], key: str, *, reverse: bool = False) -> list[CatalogueRow]:
    """Rows by one of their names; those without a value are last in both directions.

    Raises ConfigError if no row has that name, or if it has numbers in some and text in others.
    """
    rows = list(rows)
    names = {*COLUMNS, *(name for row in rows for name in row)}
    if key not in names:
        raise ConfigError.of("--sort", f"no column {key!r}{near_match(key, names)}")
    known = [row for row in rows if row.get(key) is not None]
    if len({isinstance(row[key], str) for row in known}) > 1:
        raise ConfigError.of("--sort", f"{key} is a number in some sessions and text in others")
    value: Callable[[CatalogueRow], Any] = itemgetter(key)
    return sorted(known, key=value, reverse=reverse) + [row for row in rows if row.get(key) is None]


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
    row = {
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
    gains = {name: _value(value) for name, value in gains_in(metadata).items()}
    described = {key: _words(value) for key, value in metadata.get("description", {}).items() if value}
    more: CatalogueRow = {
        **{name: value for name, value in card.items() if isinstance(value, int | float) and name != "schema_version"},
        **gains,
        "gains": ", ".join(gains) or None,
        "reference_slip": _value(controller.get("reference_slip")),
        "reason": session.get("reason"),
        "profile": rig.get("profile"),
        "simulated": rig.get("simulated"),
        "virtual_time": rig.get("virtual_time"),
        "seed": _value(metadata.get("software", {}).get("seed")),
        "host": metadata.get("host", {}).get("hostname"),
        **described,
    }
    return row | {name: value for name, value in more.items() if name not in row}


def _number(value: object) -> int | float | None:
    return value if isinstance(value, int | float) else None


def _value(text: str | None) -> float | str | None:
    """A finite number if the text is one."""
    if text is not None and text.isdecimal() and len(text) < _MOST_DIGITS:
        return int(text)
    try:
        number = finite(float(text or ""))
    except ValueError:
        return text
    return text if number is None else number


def _words(text: str) -> str:
    """Tags, which are JSON, as words with commas; other texts as they are."""
    try:
        found = json.loads(text) if text.startswith("[") else None
    except ValueError:
        return text
    return ", ".join(map(str, found)) if isinstance(found, list) else text


def _broken(path: Path, error: SessionError) -> CatalogueRow:
    problem = str(error).removeprefix(f"{path}: ")
    return {**dict.fromkeys(COLUMNS), "session": str(path), "outcome": BROKEN, "problem": problem}
