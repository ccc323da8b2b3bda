"""Brings sessions of other versions of the format to the columns and metadata of this one.

A file's rows have the layout of its own descriptor, and its columns and the members of its enumerations go by name.
What this version has and the file has not, a step makes of what the file has. So a column keeps its meaning for ever:
another meaning, or another unit, is another name.

A new version of the format is one more step here, and one more small session in tests/sessions/archive; a step that
was released stays as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.format import DOUBLE, ENUM, FLOAT, Declared, Members, Message, MessageKind, declared
from inteco_abs.sessions.container import DamagedError

Array = npt.NDArray[Any]
Metadata = dict[str, dict[str, str]]
"""Facts by record name without `inteco_abs.`."""

_NO_MEMBER: Final = 0xFF
"""Number of a member that this version does not know, in an enumeration without UNKNOWN."""


class Made(NamedTuple):
    """A column that a version has brought."""

    topic: str
    name: str
    make: Callable[..., Array]
    """Takes the number of rows and the columns `of`; gives the new one."""
    of: tuple[str, ...] = ()
    """Columns as the version before has called them; those that have no other successor end with it."""


class Migration(NamedTuple):
    """What a session of the version before becomes."""

    to: int
    """The version that it then has."""
    columns: tuple[Made, ...] = ()
    dropped: tuple[tuple[str, str], ...] = ()
    """Topic and name of columns that end with nothing in their place."""
    metadata: Callable[[Metadata], Metadata] = lambda metadata: metadata


def not_measured(rows: int) -> Array:
    """A column of floating point that the version before has not had."""
    return np.full(rows, np.nan)


def renamed(_rows: int, column: Array) -> Array:
    """A column that the version before has under another name."""
    return column


FIRST: Final = 1
STEPS: tuple[Migration, ...] = (
    Migration(2, (Made("/sim/truth", "adhesion", not_measured),)),
    Migration(3),  # new reason RUN_UP_IMPLAUSIBLE, and guard.run_up_factor, which `parse_config` may find absent
    Migration(
        4,
        (
            Made("/abs/tick", "drive_request", renamed, ("drive_wish",)),
            Made("/abs/tick", "brake_request", renamed, ("brake_wish",)),
        ),
    ),
)
"""From each version to the next, beginning with the one behind `FIRST`."""


class UnsupportedError(DamagedError):
    """The file is whole, and its messages are of another program, or too different a version of this one."""


def newest() -> int:
    """The version that this program writes."""
    return STEPS[-1].to if STEPS else FIRST


def version_of(metadata: Metadata) -> int:
    """The version that a session says it has; the newest if it does not say, as one that was cut early."""
    told = metadata.get("session", {}).get("format_version", "")
    return int(told) if told.isdecimal() and len(told) < 10 else newest()


def migrated(metadata: Metadata) -> Metadata:
    """The session's metadata in the words of this version."""
    version = version_of(metadata)
    for step in STEPS:
        if step.to > version:
            metadata = step.metadata(metadata)
    return metadata


def newer(metadata: Metadata) -> str:
    """Empty unless the session says that it is of a version behind the newest, else that it is."""
    version = version_of(metadata)
    return f"its format {version} is newer than {newest()}, the newest known here" if version > newest() else ""


class MessageLayout:
    """Of messages of this version."""

    unknown: tuple[str, ...] = ()
    """Columns and members that this version does not know, and columns that it misses; in words."""

    def __init__(self, message: Message) -> None:
        self.message = message

    def well_formed(self, data: bytes) -> bool:
        """Whether `data` is messages as the file declares them, back to back."""
        return self.message.well_formed(data)

    def upgraded(self, data: bytes) -> bytes:
        """The messages in `data` as this version has them."""
        return data


class _ForeignLayout(MessageLayout):
    """Of messages that a file declares otherwise. Raises UnsupportedError if too much is missing."""

    def __init__(self, own: Declared, today: Message) -> None:
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


_ADVICE: Final = "another version of this program made it, or another program"
_LONGEST_DESCRIPTOR: Final = 1 << 16


def message_layout(today: Message, name: str, descriptor: bytes) -> MessageLayout:
    """Of messages that a file declares under the topic of `today`. Raises UnsupportedError if they are none of ours."""
    if len(descriptor) > _LONGEST_DESCRIPTOR:
        raise UnsupportedError(f"{today.topic} is declared in {len(descriptor)} bytes, more than {_LONGEST_DESCRIPTOR}")
    return _layout(today, name, descriptor, STEPS)


@lru_cache(maxsize=16)
def _layout(today: Message, name: str, descriptor: bytes, _steps: tuple[Migration, ...]) -> MessageLayout:
    if (name, descriptor) == (today.name, today.descriptor()):
        return MessageLayout(today)
    try:
        if name != today.name:
            raise ValueError(f"it is called {name}")  # noqa: TRY301  named below as all others
        return _ForeignLayout(declared(descriptor, name, today.topic), today)
    except ValueError as error:
        raise UnsupportedError(
            f"{today.topic} has another layout than {today.name} here: {error}; {_ADVICE}"
        ) from error


def _made(topic: str, there: set[str]) -> list[Made]:
    """What the steps make, in order, of a file's own columns and of what was made of them."""
    found = []
    for made in (made for step in STEPS for made in step.columns if made.topic == topic):
        if made.name not in there and there.issuperset(made.of):
            found.append(made)
            there.add(made.name)
    return found


def _serves(own: MessageKind | None, today: MessageKind) -> bool:
    """Whether a column of one kind can say everything that was said in one of another."""
    if own is None or (own.type_number == ENUM) != (today.type_number == ENUM):
        return False
    return np.can_cast(own.dtype, today.dtype, "safe")


def _renumbered(members: type[IntEnum], own: Members) -> npt.NDArray[np.uint8]:
    """Number in this version for each of the file's."""
    here = members.__members__
    strange = here.get("UNKNOWN", _NO_MEMBER)
    numbers = np.full(1 << 8, strange, np.uint8)
    for number, name in own.items():
        numbers[number] = here.get(name, strange)
    return numbers
