"""An index of sessions in an SQLite database in the user's cache, which can be deleted at any time.

Each file's row is kept with size, time, and number of the file; one that differs in any of them is read again.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from inteco_abs.analysis.conditions import Condition
from inteco_abs.errors import ConfigError, near_match

_VERSION: Final = 2
"""Of the rows; others are made again."""
_WAIT_S: Final = 2.0
"""Time that another process may take to write."""

Facts = dict[str, Any]


def default_index() -> Path:
    """Path of the index: in the folder for caches (XDG Base Directory Specification)."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    return Path(cache) / "inteco-abs" / "sessions.sqlite"


def indexed(
    files: Sequence[Path], read: Callable[[Path], Facts], where: Condition | None, index: Path
) -> list[tuple[int, Facts]]:
    """Position and facts of each file that fulfils the condition `where`, by `read` or from the `index`.

    Raises ConfigError for a name that no file has.
    """
    with _database(index) as database:
        known = dict(database.execute("SELECT path, state FROM files"))
        paths = {str(file.absolute()): file for file in files}
        changed = {path: state for path, file in paths.items() if (state := _state(file)) != known.get(path)}
        rows = [(path, state, json.dumps(read(paths[path]))) for path, state in changed.items()]
        with suppress(sqlite3.OperationalError):  # another process writes, or the disk is full: read again next time
            database.executemany("INSERT OR REPLACE INTO files VALUES (?, ?, ?)", rows)
            database.commit()
        database.execute("CREATE TEMP TABLE wanted (path TEXT PRIMARY KEY, at INTEGER, facts TEXT)")
        database.executemany(
            "INSERT INTO wanted (path, at) VALUES (?, ?)", ((path, at) for at, path in enumerate(paths))
        )
        database.execute("UPDATE wanted SET facts = (SELECT facts FROM files WHERE files.path = wanted.path)")
        database.executemany("UPDATE wanted SET facts = ?2 WHERE path = ?1", ((path, facts) for path, _, facts in rows))
        if where is not None:
            _require_known(database, where)
        condition, parameters = (where.sql, where.parameters) if where is not None else ("1", [])
        found = database.execute(f"SELECT at, facts FROM wanted WHERE {condition} ORDER BY at", parameters)  # noqa: S608  no text of a user: names and values are parameters
        return [(at, json.loads(facts)) for at, facts in found]


def _require_known(database: sqlite3.Connection, where: Condition) -> None:
    for name in where.names:
        path = f"$.{json.dumps(name)}"
        query = "SELECT 1 FROM wanted WHERE json_type(facts, ?) IS NOT NULL LIMIT 1"
        if database.execute(query, [path]).fetchone() is None and database.execute("SELECT 1 FROM wanted").fetchone():
            names = [key for (key,) in database.execute("SELECT DISTINCT key FROM wanted, json_each(wanted.facts)")]
            raise ConfigError.of("--where", f"no session has {name!r}{near_match(name, names)}")


def _state(file: Path) -> str:
    """What changes whenever the file does."""
    try:
        found = file.stat()
    except OSError:
        return "missing"
    return f"{found.st_size} {found.st_mtime_ns} {found.st_ctime_ns} {found.st_ino}"


@contextmanager
def _database(index: Path) -> Iterator[sqlite3.Connection]:
    """The index; one that is damaged or of another version is made again, and without a place it is in memory."""
    database = _opened(index)
    try:
        yield database
    finally:
        database.close()


def _opened(index: Path) -> sqlite3.Connection:
    for _ in range(2):
        try:
            index.parent.mkdir(parents=True, exist_ok=True)
            return _checked(sqlite3.connect(index, timeout=_WAIT_S))
        except sqlite3.OperationalError:  # locked, or no place for it
            break
        except (sqlite3.DatabaseError, OSError):
            with suppress(OSError):
                index.unlink()
    return _checked(sqlite3.connect(":memory:"))


def _checked(database: sqlite3.Connection) -> sqlite3.Connection:
    """The database with its table. Raises sqlite3.Error if it is damaged."""
    try:
        if database.execute("PRAGMA user_version").fetchone() != (_VERSION,):
            database.execute("DROP TABLE IF EXISTS files")
            database.execute(f"PRAGMA user_version = {_VERSION}")
        database.execute("CREATE TABLE IF NOT EXISTS files (path TEXT PRIMARY KEY, state TEXT, facts TEXT)")
        database.execute("SELECT count(*), sum(length(facts)) FROM files").fetchone()  # a damaged page shows
    except sqlite3.Error:
        database.close()
        raise
    return database
