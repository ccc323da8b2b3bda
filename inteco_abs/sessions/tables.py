"""A session as tables of numpy columns, each with unit and meaning, for other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import AbsError, ConfigError, near_match
from inteco_abs.format import TICK, TRUTH, Column
from inteco_abs.sessions.reader import Session
from inteco_abs.sessions.rows import joined_rows

BLOCK_ROWS: Final = 1 << 14
"""Rows of a table that an export handles at once."""
_EVENT_COLUMNS: Final = {
    "time_ns": ("ns", "monotonic clock, as in the tick"),
    "unix_ns": ("ns", "wall clock, since 1970"),
    "level": ("1", "2 information, 3 warning, 4 error"),
    "text": ("text", "what happened"),
}


_COLUMN_COLUMNS: Final = {
    "table": "which file the column is in",
    "column": "its name there",
    "unit": "of its values, as in UCUM",
    "meaning": "what they are",
}


class Table(NamedTuple):
    """Rows of one kind in a session, in order of time."""

    name: str
    """`tick`, `truth` or `events`; `columns` of these."""
    dtype: np.dtype[np.void]
    number: int
    """Number of rows."""
    blocks: Callable[[], Iterator[npt.NDArray[np.void]]]
    """All rows in blocks; may raise SessionError."""
    units: dict[str, str]
    """Units by column, as in UCUM; `1` has no dimension, `text` is not a unit."""
    meanings: dict[str, str]

    @classmethod
    def of(cls, name: str, rows: npt.NDArray[np.void], units: dict[str, str], meanings: dict[str, str]) -> Self:
        """A table of rows in memory."""
        return cls(name, rows.dtype, len(rows), lambda: iter([rows]), units, meanings)

    @property
    def rows(self) -> npt.NDArray[np.void]:
        """All rows."""
        blocks = list(self.blocks())
        return blocks[0] if len(blocks) == 1 else joined_rows(np.empty(0, self.dtype), *blocks)

    def column(self, name: str) -> npt.NDArray[Any]:
        """All values of one column as a contiguous array."""
        values: npt.NDArray[Any] = np.ascontiguousarray(self.rows[name])
        return values


def tables(session: Session) -> list[Table]:
    """Table `tick`, then `truth` and `events` unless they are empty."""
    found = [
        Table(
            name,
            message.dtype,
            session.rows.numbers[message.topic],
            partial(_blocks, session, at),
            {column.name: column.unit for column in message.columns},
            {column.name: _meaning(column) for column in message.columns},
        )
        for at, (name, message) in enumerate({"tick": TICK, "truth": TRUTH}.items())
    ]
    return [table for table in (*found, _events(session)) if table.name == "tick" or table.number]


def _blocks(session: Session, at: int) -> Iterator[npt.NDArray[np.void]]:
    return (block[at] for block in session.blocks(BLOCK_ROWS))


def columns_of(found: Sequence[Table]) -> Table:
    """Table of the columns' units and meanings, for formats that cannot hold them."""
    lines = [(table.name, name, unit, table.meanings[name]) for table in found for name, unit in table.units.items()]
    widths = [max(map(len, texts)) for texts in zip(*lines, strict=True)]
    names = tuple(_COLUMN_COLUMNS)
    rows = np.array(lines, [(name, f"<U{width}") for name, width in zip(names, widths, strict=True)])
    return Table.of("columns", rows, dict.fromkeys(names, "text"), dict(_COLUMN_COLUMNS))


def to_pandas(session: Session, table: str = "tick") -> Any:
    """One of the session's `tables` as a pandas DataFrame, with `units` and `meanings` in its attrs.

    Raises AbsError without pandas, ConfigError if the session does not have the table.
    """
    found = _named(session, table)
    try:
        import pandas as pd  # noqa: PLC0415  heavy, and not ours to require
    except ImportError as error:
        raise AbsError("to_pandas needs pandas: pip install pandas") from error
    frame = pd.DataFrame({name: found.column(name) for name in found.units})
    frame.attrs = {"units": found.units, "meanings": found.meanings}
    return frame


def to_polars(session: Session, table: str = "tick") -> Any:
    """One of the session's `tables` as a polars DataFrame, without units.

    Raises AbsError without polars, ConfigError if the session does not have the table.
    """
    found = _named(session, table)
    try:
        import polars as pl  # noqa: PLC0415  heavy, and not ours to require
    except ImportError as error:
        raise AbsError("to_polars needs polars: pip install polars") from error
    return pl.DataFrame({name: found.column(name) for name in found.units})


def _named(session: Session, name: str) -> Table:
    found = {table.name: table for table in tables(session)}
    if name not in found:
        raise ConfigError.of("table", f"{session.path} has no {name!r}{near_match(name, found)}")
    return found[name]


def _meaning(column: Column) -> str:
    members = column.kind.members
    if members is None:
        return column.meaning
    return f"{column.meaning}: {', '.join(f'{int(member)} {member.name}' for member in members)}"


def _events(session: Session) -> Table:
    longest = max((len(event.text) for event in session.log), default=1)
    rows = np.zeros(
        len(session.log), [("time_ns", "<i8"), ("unix_ns", "<u8"), ("level", "u1"), ("text", f"<U{max(longest, 1)}")]
    )
    for at, event in enumerate(session.log):
        rows[at] = 0, event.unix_ns, event.level, event.text
    rows["time_ns"] = (rows["unix_ns"] - np.uint64(session.epoch_ns % (1 << 64))).view(np.int64)
    units = {name: unit for name, (unit, _) in _EVENT_COLUMNS.items()}
    return Table.of("events", rows, units, {name: meaning for name, (_, meaning) in _EVENT_COLUMNS.items()})
