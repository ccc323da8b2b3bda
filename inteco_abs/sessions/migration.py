"""Upgrades sessions of other format versions to the columns and metadata of this version.

Rows are read by the descriptor in the file; columns and members of enumerations are matched by name, and a step makes
the columns that the file lacks. So a column never changes its meaning: another meaning or unit needs another name.

A new format version adds a step here and a small session in tests/sessions/archive; released steps do not change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs import elementary
from inteco_abs.format import DOUBLE, ENUM, FLOAT, DeclaredMessage, Members, Message, MessageKind, declared_message
from inteco_abs.sessions.container import DamagedError

Array = npt.NDArray[Any]
Metadata = dict[str, dict[str, str]]
"""Facts by record name without `inteco_abs.`."""

_NO_MEMBER: Final = 0xFF
"""Number for an unknown member of an enumeration without UNKNOWN."""


class NewColumn(NamedTuple):
    """A column that a version adds."""

    topic: str
    name: str
    make: Callable[..., Array]
    """Makes it from the number of rows and the columns `of`."""
    of: tuple[str, ...] = ()
    """Names of columns of the previous version, which it replaces."""


class Migration(NamedTuple):
    """Changes from the previous version."""

    to: int
    """The new version."""
    columns: tuple[NewColumn, ...] = ()
    dropped: tuple[tuple[str, str], ...] = ()
    """Topic and name of columns without a successor."""
    metadata: Callable[[Metadata], Metadata] = lambda metadata: metadata


def not_measured(rows: int) -> Array:
    """A column that the previous version did not measure: NaN."""
    return np.full(rows, np.nan)


def renamed(_rows: int, column: Array) -> Array:
    """A column with another name in the previous version."""
    return column


def _decided_with_libm(metadata: Metadata) -> Metadata:
    return {**metadata, "software": {**metadata.get("software", {}), "arithmetic": elementary.LIBM}}


FIRST: Final = 1
STEPS: tuple[Migration, ...] = (
    Migration(2, (NewColumn("/sim/truth", "adhesion", not_measured),)),
    Migration(3),  # new reason RUN_UP_IMPLAUSIBLE, and guard.run_up_factor, which `parse_config` may find absent
    Migration(
        4,
        (
            NewColumn("/abs/tick", "drive_request", renamed, ("drive_wish",)),
            NewColumn("/abs/tick", "brake_request", renamed, ("brake_wish",)),
        ),
    ),
    Migration(5, metadata=_decided_with_libm),
)
"""Steps from each version to the next, beginning after `FIRST`."""


class UnsupportedError(DamagedError):
    """The file is intact, but another program, or a too different version of this one, wrote its messages."""


def newest() -> int:
    """The version that this program writes."""
    return STEPS[-1].to if STEPS else FIRST


def version_of(metadata: Metadata) -> int:
    """Format version of a session; the newest if it is not recorded, as in a file that was cut early."""
    version = metadata.get("session", {}).get("format_version", "")
    return int(version) if version.isdecimal() and len(version) < 10 else newest()


def migrated(metadata: Metadata) -> Metadata:
    """The session's metadata as this version writes it."""
    version = version_of(metadata)
    for step in STEPS:
        if step.to > version:
            metadata = step.metadata(metadata)
    return metadata


def newer(metadata: Metadata) -> str:
    """Message about a format version newer than the newest known here; empty for other versions."""
    version = version_of(metadata)
    return f"its format {version} is newer than {newest()}, the newest known here" if version > newest() else ""


class MessageLayout:
    """Layout of messages of this version."""

    unknown: tuple[str, ...] = ()
    """Descriptions of unknown columns and members, and of missing columns."""

    def __init__(self, message: Message) -> None:
        self.message = message

    def well_formed(self, data: bytes) -> bool:
        """Whether `data` consists of messages as the file declares them, back to back."""
        return self.message.well_formed(data)

    def upgraded(self, data: bytes) -> bytes:
        """The messages in `data` as messages of this version."""
        return data


class _ForeignLayout(MessageLayout):
    """Layout of messages that a file declares differently. Raises ValueError if an integer column is missing."""

    def __init__(self, own: DeclaredMessage, today: Message) -> None:
        super().__init__(own.message)
        self._members, self._today = own.members, today
        kinds = {column.name: column.kind for column in own.message.columns}
        self._made = _made(today.topic, set(kinds))
        wanted = [column for column in today.columns if column.name not in {made.name for made in self._made}]
        self._missing = [column for column in wanted if not _serves(kinds.get(column.name), column.kind)]
        numbers = [column.name for column in self._missing if column.kind not in {DOUBLE, FLOAT}]
        if numbers:
            raise ValueError(f"it has no {', '.join(numbers)}")
        self._renumbered = {
            column.name: _renumbered(column.kind.members, own.members[column.name])
            for column in wanted
            if column.kind.members is not None
        }
        self.unknown = (*self._left_out(), *(f"{today.topic}.{column.name} is missing" for column in self._missing))

    def well_formed(self, data: bytes) -> bool:
        if not super().well_formed(data):
            return False
        rows = self.message.array(data)
        return all(bool(np.isin(rows[name], list(members)).all()) for name, members in self._members.items())

    def upgraded(self, data: bytes) -> bytes:
        found = self.message.array(data)
        columns: dict[str, Array] = {column.name: found[column.name] for column in self.message.columns}
        for name, numbers in self._renumbered.items():
            columns[name] = numbers[columns[name]]
        for made in self._made:
            columns[made.name] = made.make(len(found), *(columns[name] for name in made.of))
        for column in self._missing:
            columns[column.name] = not_measured(len(found))
        filled = self._today.blank(len(found))
        rows = np.frombuffer(filled, self._today.dtype)
        for column in self._today.columns:
            rows[column.name] = columns[column.name]
        return bytes(filled)

    def _left_out(self) -> Iterator[str]:
        topic, known = self._today.topic, {column.name for column in self._today.columns}
        known |= {name for made in self._made for name in made.of}
        known |= {name for step in STEPS for of, name in step.dropped if of == topic}
        for column in self.message.columns:
            if column.name not in known:
                yield f"{topic}.{column.name} is left out"
        for column in self._today.columns:
            if column.kind.members is not None and column.name in self._renumbered:
                for name in self._members[column.name].values():
                    if name not in column.kind.members.__members__:
                        yield f"{topic}.{column.name} {name} is not known"


_ADVICE: Final = "another version of this program wrote it, or another program"
_LONGEST_DESCRIPTOR: Final = 1 << 16


def message_layout(today: Message, name: str, descriptor: bytes) -> MessageLayout:
    """Layout of messages that a file declares for the topic of `today`. Raises UnsupportedError if not readable."""
    if len(descriptor) > _LONGEST_DESCRIPTOR:
        raise UnsupportedError(f"{today.topic} is declared in {len(descriptor)} bytes, more than {_LONGEST_DESCRIPTOR}")
    return _layout(today, name, descriptor, STEPS)


@lru_cache(maxsize=16)
def _layout(today: Message, name: str, descriptor: bytes, _steps: tuple[Migration, ...]) -> MessageLayout:
    if (name, descriptor) == (today.name, today.descriptor()):
        return MessageLayout(today)
    try:
        if name != today.name:
            raise ValueError(f"it is called {name}")  # noqa: TRY301  gets its topic below, as all others
        return _ForeignLayout(declared_message(descriptor, name, today.topic), today)
    except ValueError as error:
        raise UnsupportedError(
            f"{today.topic} has another layout than {today.name} here: {error}; {_ADVICE}"
        ) from error


def _made(topic: str, there: set[str]) -> list[NewColumn]:
    """Columns that the steps make, in order, from the file's columns and from each other."""
    found = []
    for made in (made for step in STEPS for made in step.columns if made.topic == topic):
        if made.name not in there and there.issuperset(made.of):
            found.append(made)
            there.add(made.name)
    return found


def _serves(own: MessageKind | None, today: MessageKind) -> bool:
    """Whether values of a column of kind `own` fit into one of kind `today`."""
    if own is None or (own.type_number == ENUM) != (today.type_number == ENUM):
        return False
    return np.can_cast(own.dtype, today.dtype, "safe")


def _renumbered(members: type[IntEnum], own: Members) -> npt.NDArray[np.uint8]:
    """Member numbers of this version by those of the file."""
    here = members.__members__
    unknown = here.get("UNKNOWN", _NO_MEMBER)
    numbers = np.full(1 << 8, unknown, np.uint8)
    for number, name in own.items():
        numbers[number] = here.get(name, unknown)
    return numbers
