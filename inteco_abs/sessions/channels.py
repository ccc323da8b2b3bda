"""The channels of a session, the same in its file and in a live view: schemas, units, and messages that are no rows."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.format import (
    LOG_NAME,
    LOG_TOPIC,
    PARAMETERS_NAME,
    PARAMETERS_TOPIC,
    RESULT,
    RESULT_NAME,
    RESULT_TOPIC,
    Message,
    chunk,
    double,
    integer,
    log_descriptor,
    parameters_descriptor,
    result_descriptor,
    tag,
)
from inteco_abs.signals import EXPLANATIONS, Phase, Reason

INFO: Final = 2
"""Level of foxglove.Log."""
WARNING: Final = 3
ERROR: Final = 4
_STATE: Final = ("phase", "reason")


class Channel(NamedTuple):
    """A stream of messages of one protobuf schema."""

    topic: str
    schema_name: str
    descriptor: bytes
    """FileDescriptorSet of the schema."""
    facts: Mapping[str, str]
    """Metadata, such as units in JSON."""


def row_channel(message: Message, internals: Sequence[str] | None = None) -> Channel:
    """The channel of `message`, with unit and meaning of each column, and the names of the controller's internals."""
    facts = {
        "units": json.dumps({column.name: column.unit for column in message.columns}),
        "describe": json.dumps({column.name: column.meaning for column in message.columns}),
    }
    if internals is not None:
        facts["internals"] = json.dumps(list(internals))
    return Channel(message.topic, message.name, message.descriptor(), facts)


def event_channel() -> Channel:
    """The channel of the log."""
    return Channel(LOG_TOPIC, LOG_NAME, log_descriptor(), {})


def parameter_channel() -> Channel:
    """The channel of the parameters in force."""
    return Channel(PARAMETERS_TOPIC, PARAMETERS_NAME, parameters_descriptor(), {})


def result_channel() -> Channel:
    """The channel of the result card, with the unit of each metric."""
    units = {"units": json.dumps({entry.name: entry.unit for entry in RESULT})}
    return Channel(RESULT_TOPIC, RESULT_NAME, result_descriptor(), units)


def pack_event(stamp_ns: int, level: int, text: str) -> bytes:
    """An entry of the log, at UNIX time `stamp_ns`."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    stamp = integer(1, seconds) + integer(2, nanoseconds)
    return chunk(1, stamp) + integer(2, level) + chunk(3, text) + chunk(4, "inteco-abs")


def pack_parameters(values: Mapping[str, float], tick: int = 0) -> bytes:
    """Parameters in force from `tick` on."""
    entries = b"".join(chunk(1, chunk(1, name) + double(2, value)) for name, value in values.items())
    return entries + tag(2, 5) + struct.pack("<I", tick)


class StateEvents:
    """Finds the changes of phase and reason among ticks, and what the log says of them."""

    def __init__(self) -> None:
        self._before = (int(Phase.UNKNOWN), int(Reason.NONE))

    def among(self, rows: npt.NDArray[np.void]) -> Iterator[tuple[int, list[tuple[int, str]]]]:
        """Yield index, and level and text of each entry, for every change in `rows`, which follow those before."""
        changes = [np.diff(rows[name], prepend=old) != 0 for name, old in zip(_STATE, self._before, strict=True)]
        for index in np.flatnonzero(np.logical_or(*changes)).tolist():
            yield index, self._entries(*(int(rows[name][index]) for name in _STATE))

    def _entries(self, phase: int, reason: int) -> list[tuple[int, str]]:
        before, self._before = self._before, (phase, reason)
        entries = [(INFO, f"phase {Phase(phase).name}")] if phase != before[0] else []
        if reason != before[1]:
            entries.append((ERROR, f"{Reason(reason).name}: {EXPLANATIONS[Reason(reason)]}"))
        return entries
