"""A session as tables of numpy columns, each with unit and meaning, for other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import AbsError, ConfigError, near_match
from inteco_abs.format import INTERNALS, TICK, TRUTH, Column, Message
from inteco_abs.quantities import Quantity
from inteco_abs.sessions.channels import internals_of
from inteco_abs.sessions.reader import Session
from inteco_abs.sessions.rows import joined_rows

BLOCK_ROWS: Final = 1 << 14
"""Rows of a table that an export handles at once."""
_EVENT_COLUMNS: Final = {
    "time_ns": ("ns", "monotonic clock, as in the tick"),
    "unix_ns": ("ns", "wall clock, since 1970"),
    "level": ("1", "2 information, 3 warning, 4 error"),
    "text": ("", "what happened"),
}


class Table(NamedTuple):
    """Rows of one kind in a session, in order of time."""

    name: str
    """`tick`, `truth` or `events`."""
    dtype: np.dtype[np.void]
    number: int
    """Number of rows."""
    blocks: Callable[[], Iterator[npt.NDArray[np.void]]]
    """All rows in blocks; may raise SessionError."""
    units: dict[str, str]
    """Units by column, as in UCUM; `1` has no dimension, empty is a text, or unknown."""
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
    """Table `tick`, then `truth` and `events` unless they are empty.

    The controller's internals have their own names instead of `c0` and so on, unless another column has them.
    """
    found = [
        Table(
            name,
            _named_as(message.dtype, columns),
            session.rows.numbers[message.topic],
            partial(_blocks, session, at, columns),
            {column.name: column.unit for column in columns},
            {column.name: column.meaning for column in columns},
        )
        for at, (name, message) in enumerate({"tick": TICK, "truth": TRUTH}.items())
        for columns in (_columns(message, session),)
    ]
    return [table for table in (*found, _events(session)) if table.name == "tick" or table.number]


def _columns(message: Message, session: Session) -> list[Quantity]:
    columns = {column.name: Quantity(column.name, column.unit, _meaning(column)) for column in message.columns}
    if message is TICK:
        for column, internal in zip(INTERNALS, internals_of(session.channels), strict=False):
            if internal.name.isidentifier() and internal.name not in {each.name for each in columns.values()}:
                columns[column] = internal
            elif internal.name:
                columns[column] = Quantity(column, internal.unit, f"{internal.name}: {internal.meaning}")
    return list(columns.values())


def _named_as(dtype: np.dtype[np.void], columns: Sequence[Quantity]) -> np.dtype[np.void]:
    """The same layout with other names."""
    known: Any = dtype.fields
    fields = [known[name] for name in dtype.names or ()]
    names, formats, offsets = (
        [each.name for each in columns],
        [each[0] for each in fields],
        [each[1] for each in fields],
    )
    layout: np.dtype[np.void] = np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": dtype.itemsize}
    )
    return layout


def _blocks(session: Session, at: int, columns: Sequence[Quantity]) -> Iterator[npt.NDArray[np.void]]:
    for block in session.blocks(BLOCK_ROWS):
        yield block[at].view(_named_as(block[at].dtype, columns))


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
