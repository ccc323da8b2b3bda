"""Many sessions as one dataset: Parquet in folders by table and session, for DuckDB, polars and others."""

from __future__ import annotations

import importlib.util
import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from inteco_abs.analysis.catalogue import session_row
from inteco_abs.errors import AbsError, ConfigError, SessionError, describe_disk
from inteco_abs.sessions import check_folder, read_session, tables, write_parquet

SESSIONS: Final = "sessions.parquet"
"""One row per session, with everything that `list --json` has."""


def write_dataset(files: Sequence[Path], out: Path) -> int:
    """Write the sessions in `files` to the new folder `out`; return the number of rows in all tables.

    `out/tick/session=ID/rows.parquet`, the same for `truth` and `events`, and `sessions.parquet`, whose column
    `session` is that ID. One session after the other is read and checked, in blocks; the folder appears when it is
    complete. Raises ConfigError for two files of one session, AbsError without pyarrow, SessionError.
    """
    if importlib.util.find_spec("pyarrow") is None:
        raise AbsError("a dataset needs pyarrow: pip install 'inteco-abs[export]'")
    if out.exists():
        raise ConfigError.of("OUT", f"{out}: exists already; choose another name")
    check_folder(out.absolute().parent, "OUT")
    part = out.with_name(f"{out.name}.{secrets.token_hex(8)}.part")
    try:
        try:
            number = _write(files, part)
            part.rename(out)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    except OSError as error:
        raise SessionError(f"{out} cannot be written: {describe_disk(error)}") from error
    return number


def _write(files: Sequence[Path], folder: Path) -> int:
    rows, number = dict[str, dict[str, Any]](), 0
    for file in files:
        session = read_session(file)
        key = session.metadata.get("session", {}).get("session_id") or file.stem
        if key in rows:
            raise ConfigError.of("FILE", f"{file}: is the same session as {rows[key]['file']}")
        rows[key] = {**session_row(file), "session": key, "file": str(file)}
        for table in tables(session):
            place = folder / table.name / f"session={key}"
            place.mkdir(parents=True)
            write_parquet(place / "rows.parquet", [table], session)
            number += table.number
    _write_rows(list(rows.values()), folder / SESSIONS)
    return number


def _write_rows(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write rows whose keys differ; a column with numbers and texts becomes text."""
    import pyarrow as pa  # noqa: PLC0415  heavy, and an extra
    from pyarrow import parquet  # noqa: PLC0415

    columns = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        kinds = {type(value) for value in values if value is not None}
        if str in kinds and len(kinds) > 1:
            values = [None if value is None else str(value) for value in values]
        elif kinds == {int, float}:
            values = [None if value is None else float(value) for value in values]
        columns[name] = pa.array(values)
    parquet.write_table(pa.table(columns), path, compression="zstd")
